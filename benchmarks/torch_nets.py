"""ADGCNN and DGCNN written in PyTorch, edge by edge as DGCNN's authors do: the peer that ours is timed and compared with.

Modules and parameters carry the names and shapes of `cablejax.nets`, so that weights are exchanged by name. The
networks start from posed clouds (`cablejax.nets.pose_clouds`); torch is installed by hand, see docs/dependencies.md.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class BatchNorm(nn.Module):
    """Batch normalisation of the last axis."""

    def __init__(self, features: int):
        super().__init__()
        self.scale, self.bias = nn.Parameter(torch.ones(features)), nn.Parameter(torch.zeros(features))
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("var", torch.ones(features))

    def forward(self, x: Tensor) -> Tensor:
        flat = x.reshape(-1, x.shape[-1])
        return F.batch_norm(flat, self.mean, self.var, self.scale, self.bias, self.training, 0.1, 1e-5).reshape(x.shape)


class Linear(nn.Module):
    """`x @ kernel + bias`."""

    def __init__(self, c: int, d: int, *, bias: bool = True):
        super().__init__()
        self.kernel = nn.Parameter(torch.randn(c, d) / math.sqrt(c))
        self.bias = nn.Parameter(torch.zeros(d)) if bias else None

    def forward(self, x: Tensor) -> Tensor:
        return x @ self.kernel if self.bias is None else x @ self.kernel + self.bias


def feature_graph(x: Tensor, k: int) -> Tensor:
    """The k nearest rows `[b, n, k]` of each row of `[b, n, c]`, itself among them, by DGCNN's matrix product."""
    x = x.detach()
    x = x - x.mean(dim=1, keepdim=True)
    square = (x**2).sum(dim=-1)
    return (2 * x @ x.transpose(1, 2) - square[:, :, None] - square[:, None, :]).topk(k, dim=-1).indices


class ChannelAttention(nn.Module):
    """Eq. (12), pooled over all edges of a cloud."""

    def __init__(self, features: int):
        super().__init__()
        hidden = max(features // 4, 4)
        self.squeeze, self.excite = Linear(features, hidden), Linear(hidden, features)

    def forward(self, edges: Tensor) -> Tensor:
        largest, mean = edges.amax(dim=(1, 2)), edges.mean(dim=(1, 2))
        return torch.sigmoid(sum(self.excite(F.relu(self.squeeze(pooled))) for pooled in (largest, mean)))


class AEdgeConv(nn.Module):
    """Eqs. (11)-(14) with a tensor per edge."""

    def __init__(self, c: int, d: int, *, k: int, attention: bool):
        super().__init__()
        self.k = k
        self.kernel = nn.Parameter(torch.randn(2 * c, d) / math.sqrt(c))
        self.norm = BatchNorm(d)
        self.attention = ChannelAttention(d) if attention else None

    def forward(self, x: Tensor, graph: Tensor | None = None) -> Tensor:
        b, n, c = x.shape
        graph = feature_graph(x, self.k) if graph is None else graph
        rows = (graph + n * torch.arange(b)[:, None, None]).reshape(-1)
        neighbor = x.reshape(b * n, c)[rows].reshape(b, n, -1, c)
        center = x[:, :, None, :].expand_as(neighbor)
        edges = self.norm(torch.cat([center, neighbor - center], dim=-1) @ self.kernel)
        if self.attention is not None:
            edges = edges * self.attention(edges)[:, None, None, :]
        return F.leaky_relu(edges, 0.2).amax(dim=2)


class SeparableConv(nn.Module):
    """3x3 depthwise, wrapped around the cable and zero-padded along it, then 1x1, batch normalisation, GELU."""

    def __init__(self, c: int, d: int, *, dilation: int = 1):
        super().__init__()
        self.dilation = dilation
        self.depthwise = nn.Parameter(torch.randn(3, 3, c) / 3)
        self.pointwise, self.norm = Linear(c, d, bias=False), BatchNorm(d)

    def forward(self, grid: Tensor) -> Tensor:
        r = self.dilation
        x = F.pad(F.pad(grid.permute(0, 3, 1, 2), (r, r, 0, 0), mode="circular"), (0, 0, r, r))
        x = F.conv2d(x, self.depthwise.permute(2, 0, 1)[:, None], groups=x.shape[1], dilation=r).permute(0, 2, 3, 1)
        return F.gelu(self.norm(self.pointwise(x)), approximate="tanh")


class FeatureEnhancement(nn.Module):
    """Five separable convolutions, skips around 2, 3 to 4, and 5."""

    def __init__(self, c: int, d: int):
        super().__init__()
        self.enter = SeparableConv(c, d)
        self.second, self.third, self.fourth, self.fifth = (SeparableConv(d, d) for _ in range(4))

    def forward(self, grid: Tensor) -> Tensor:
        x = self.enter(grid)
        x = x + self.second(x)
        x = x + self.fourth(self.third(x))
        return x + self.fifth(x)


class FusionBranch(nn.Module):
    """Two separable convolutions and a dilated one with a skip."""

    def __init__(self, c: int, d: int, *, dilation: int):
        super().__init__()
        self.first, self.second = SeparableConv(c, d), SeparableConv(d, d)
        self.dilated = SeparableConv(d, d, dilation=dilation)

    def forward(self, grid: Tensor) -> Tensor:
        x = self.second(self.first(grid))
        return x + self.dilated(x)


class FeatureFusion(nn.Module):
    """Three branches, added, and a 1x1 convolution."""

    def __init__(self, c: int, d: int, *, width: int):
        super().__init__()
        self.branches = nn.ModuleList([FusionBranch(c, width, dilation=rate) for rate in (2, 3, 4)])
        self.mix = Linear(width, d)

    def forward(self, grid: Tensor) -> Tensor:
        return self.mix(sum(branch(grid) for branch in self.branches))


class RasterStage(nn.Module):
    """Enhancement of the shallow and the deep map and their fusion, on the cylinder raster."""

    def __init__(self, shallow: int, deep: int, d: int, *, width: int, shape: tuple[int, int], half_length: float):
        super().__init__()
        self.split, self.shape, self.half_length = shallow, shape, half_length
        self.enhance_shallow = FeatureEnhancement(shallow + 2, width)
        self.enhance_deep = FeatureEnhancement(deep + 2, width)
        self.fuse = FeatureFusion(2 * width, d, width=width)

    def shares(self, axial: Tensor, angle: Tensor) -> Tensor:
        """Bilinear shares `[b, n, cells]`: closed in angle, the ends of the axis held."""
        height, width = self.shape
        row = ((axial + self.half_length) / (2 * self.half_length) * height - 0.5).clamp(0, height - 1)
        column = angle / (2 * math.pi) * width - 0.5
        total = torch.zeros(*axial.shape, height * width)
        for up in (0, 1):
            for over in (0, 1):
                cell_row = (row.floor() + up).clamp(max=height - 1)
                cell = cell_row * width + torch.remainder(column.floor() + over, width)
                share = (row - row.floor() if up else 1 - (row - row.floor())) * (
                    column - column.floor() if over else 1 - (column - column.floor())
                )
                total.scatter_add_(2, cell.long()[..., None], share[..., None])
        return total * (axial.abs() <= self.half_length)[..., None]

    def forward(self, points: Tensor, axial: Tensor, angle: Tensor, radius: Tensor) -> Tensor:
        shares = self.shares(axial, angle)
        weight = shares.sum(dim=1)
        mean = shares * torch.where(weight > 1e-3, 1 / weight, 0.0)[:, None, :]
        grid = mean.transpose(1, 2) @ torch.cat([points, radius[..., None]], dim=-1)
        occupancy = weight / weight.sum(dim=1, keepdim=True).clamp(min=1) * weight.shape[1]
        grid, occupancy = (t.reshape(len(t), *self.shape, -1) for t in (grid, occupancy))
        extras = torch.cat([grid[..., -1:], occupancy], dim=-1)
        maps = grid[..., : self.split], grid[..., self.split : -1]
        shallow, deep = (torch.cat([each, extras], dim=-1) for each in maps)
        fused = self.fuse(torch.cat([self.enhance_shallow(shallow), self.enhance_deep(deep)], dim=-1))
        return shares @ fused.reshape(len(fused), -1, fused.shape[-1])


class PooledLayer(nn.Module):
    """A layer shared by all points, then maximum and mean."""

    def __init__(self, c: int, d: int):
        super().__init__()
        self.kernel, self.norm = nn.Parameter(torch.randn(c, d) / math.sqrt(c)), BatchNorm(d)

    def forward(self, x: Tensor) -> Tensor:
        x = F.leaky_relu(self.norm(x @ self.kernel), 0.2)
        return torch.cat([x.amax(dim=1), x.mean(dim=1)], dim=-1)


class Classifier(nn.Module):
    """Fully connected layers with batch normalisation and LeakyReLU."""

    def __init__(self, c: int, widths: tuple[int, ...], classes: int):
        super().__init__()
        sizes = [c, *widths]
        self.hidden = nn.ModuleList([Linear(a, b, bias=False) for a, b in zip(sizes[:-1], widths, strict=True)])
        self.norms = nn.ModuleList([BatchNorm(d) for d in widths])
        self.logits = Linear(sizes[-1], classes)

    def forward(self, x: Tensor) -> Tensor:
        for linear, norm in zip(self.hidden, self.norms, strict=True):
            x = F.leaky_relu(norm(linear(x)), 0.2)
        return self.logits(x)


class ADGCNN(nn.Module):
    """The whole network; `raster_width=None` leaves enhancement and fusion out (DGCNN: `attention=False` besides)."""

    def __init__(
        self,
        classes: int,
        *,
        k: int = 20,
        attention: bool = True,
        widths: tuple[int, ...] = (32, 32, 64, 128),
        raster_shape: tuple[int, int] = (8, 16),
        raster_width: int | None = 64,
        half_length: float = 3.0,
        shared: int = 512,
        head: tuple[int, ...] = (256, 128),
    ):
        super().__init__()
        inputs, total = (4, *widths[:-1]), sum(widths)
        self.layers = nn.ModuleList(
            [AEdgeConv(c, d, k=k, attention=attention) for c, d in zip(inputs, widths, strict=True)]
        )
        shallow, options = sum(widths[: len(widths) // 2]), {"shape": raster_shape, "half_length": half_length}
        self.raster = (
            None
            if raster_width is None
            else RasterStage(shallow, total - shallow, total, width=raster_width, **options)
        )
        self.shared = PooledLayer(total, shared)
        self.classifier = Classifier(2 * shared, head, classes)

    def forward(self, features: Tensor, axial: Tensor, angle: Tensor, radius: Tensor) -> Tensor:
        x, maps = features, []
        for layer in self.layers:
            x = layer(x)
            maps.append(x)
        joined = torch.cat(maps, dim=-1)
        if self.raster is not None:
            joined = joined + self.raster(joined, axial, angle, radius)
        return self.classifier(self.shared(joined))


def dgcnn(classes: int, *, k: int = 20) -> ADGCNN:
    """DGCNN's classification network: 64, 64, 128, 256, 1,024."""
    return ADGCNN(
        classes, k=k, attention=False, widths=(64, 64, 128, 256), raster_width=None, shared=1024, head=(512, 256)
    )
