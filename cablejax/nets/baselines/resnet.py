"""ResNet50 (He, Zhang, Ren, Sun 2016) on a depth image."""

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.depth import Size, render, sides
from cablejax.nets.init import he_normal, lecun_normal
from cablejax.nets.norm import BatchNorm

STAGES = ((64, 3), (128, 4), (256, 6), (512, 3))  # width, blocks
EXPANSION = 4


class Bottleneck(nnx.Module):
    """1x1, 3x3, 1x1 convolutions with a skip; the stride is the 3x3's.

    Args:
        in_features: Channels of the input.
        width: Channels inside; four times as many leave.
        stride: Stride of the block.
    """

    def __init__(self, in_features: int, width: int, *, stride: int, rngs: nnx.Rngs):
        out = width * EXPANSION

        def conv(c: int, d: int, side: int, step: int = 1) -> nnx.Conv:
            return nnx.Conv(
                c, d, (side, side), strides=step, padding=side // 2, use_bias=False, kernel_init=he_normal, rngs=rngs
            )

        self.conv1, self.norm1 = conv(in_features, width, 1), BatchNorm(width)
        self.conv2, self.norm2 = conv(width, width, 3, stride), BatchNorm(width)
        self.conv3, self.norm3 = conv(width, out, 1), BatchNorm(out)
        project = stride != 1 or in_features != out
        self.project = conv(in_features, out, 1, stride) if project else None
        self.project_norm = BatchNorm(out) if project else None

    def __call__(self, x: Float[Array, "b h w c"]) -> Float[Array, "b i j d"]:
        y = jax.nn.relu(self.norm1(self.conv1(x)))
        y = jax.nn.relu(self.norm2(self.conv2(y)))
        y = self.norm3(self.conv3(y))
        if self.project is not None and self.project_norm is not None:
            x = self.project_norm(self.project(x))
        return jax.nn.relu(x + y)


class ResNet50(nnx.Module):
    """A 7x7 convolution, sixteen bottlenecks in four stages, global mean, one fully connected layer.

    Departures: one input channel (depth) instead of three; the image is of `size` pixels (only the global mean sees
    it); a stage's stride is on the 3x3 convolution, as in today's libraries ("v1.5"), not on the first 1x1; C outputs. At
    three channels and 1,000 classes it has the usual 25,557,032 parameters.

    Args:
        num_classes: C.
        size: Pixels of the image's side, or rows and columns, at least 32 each.
        extent_mm: Width of what the image shows, see `depth_image`.
        in_channels: Channels of the image.
    """

    def __init__(
        self, num_classes: int, *, size: Size = 64, extent_mm: float = 128.0, in_channels: int = 1, rngs: nnx.Rngs
    ):
        rows, columns = sides(size)
        if min(rows, columns) < 32:
            raise ValueError(f"size: ResNet50's five halvings need at least 32 pixels, got {size}")
        self.size, self.extent_mm = (rows, columns), extent_mm
        self.stem = nnx.Conv(
            in_channels, 64, (7, 7), strides=2, padding=3, use_bias=False, kernel_init=he_normal, rngs=rngs
        )
        self.norm = BatchNorm(64)
        blocks, channels = [], 64
        for stage, (width, count) in enumerate(STAGES):
            for block in range(count):
                stride = 2 if stage > 0 and block == 0 else 1
                blocks.append(Bottleneck(channels, width, stride=stride, rngs=rngs))
                channels = width * EXPANSION
        self.blocks = nnx.List(blocks)
        self.logits = nnx.Linear(channels, num_classes, kernel_init=lecun_normal, rngs=rngs)

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm."""
        return self.from_image(render(xyz, mask, size=self.size, extent_mm=self.extent_mm))

    def from_image(self, image: Float[Array, "b h w c"]) -> Float[Array, "b classes"]:
        """Logits of images `[b, rows, columns, in_channels]`."""
        x = jax.nn.relu(self.norm(self.stem(image)))
        x = nnx.max_pool(jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0))), (3, 3), strides=(2, 2))  # x >= 0: zeros lose
        for block in self.blocks:
            x = block(x)
        return self.logits(jnp.mean(x, axis=(1, 2)))
