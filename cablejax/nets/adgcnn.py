"""ADGCNN: dynamic graph convolutions with channel attention, feature enhancement and fusion (section III.A)."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.aedgeconv import AEdgeConv
from cablejax.nets.diameter import DiameterHead, SizeEstimate
from cablejax.nets.enhancement import FeatureEnhancement
from cablejax.nets.fusion import FeatureFusion
from cablejax.nets.head import Classifier, PooledLayer
from cablejax.nets.init import lecun_normal
from cablejax.nets.input_channels import PosedClouds, pose_channels, pose_clouds
from cablejax.ops.raster import cylinder_raster, raster_taps, sample_raster


class ADGCNN(nnx.Module):
    """Classify cable clouds by size, Figure 1.

    AEdgeConv layers of 32, 32, 64, 128 channels, concatenated to 256; enhancement and fusion on the cylinder raster,
    added to the points' features; a shared layer of 512; max and mean pooling to 1,024; 256, 128, C.

    Args:
        num_classes: C.
        k: Neighbours per point in every graph, the point itself counted.
        attention: Channel attention, eq. (12).
        enhancement: Feature enhancement of the shallow (layers 1, 2) and the deep (3, 4) maps.
        fusion: Feature fusion of these maps.
        pose: Frame of the input, see `pose_clouds`.
        widths: Channels of the edge convolutions.
        raster_shape: Cells of the raster, (axial, angular).
        raster_width: Channels of the raster's convolutions.
        half_length_mm: Half the length of cable that the raster covers; points beyond it get nothing from the raster.
        scale_mm: Length that becomes 1 at the input.
        shared_width: Channels of the shared layer before pooling.
        head: Channels of the classifier's hidden layers.
        dropout: Rate in the classifier; the paper has none.
        regression: A second head for the diameter in mm with its standard deviation, see `with_diameter`; the paper has
            none. Training then adds its Gaussian negative log-likelihood to the loss.
    """

    def __init__(
        self,
        num_classes: int,
        *,
        k: int = 20,
        attention: bool = True,
        enhancement: bool = True,
        fusion: bool = True,
        pose: str = "cylinder",
        widths: Sequence[int] = (32, 32, 64, 128),
        raster_shape: tuple[int, int] = (8, 16),
        raster_width: int = 64,
        half_length_mm: float = 60.0,
        scale_mm: float = 20.0,
        shared_width: int = 512,
        head: Sequence[int] = (256, 128),
        dropout: float = 0.0,
        regression: bool = False,
        rngs: nnx.Rngs,
    ):
        if num_classes < 2:
            raise ValueError(f"num_classes: expected 2 or more, got {num_classes}")
        if len(widths) < 2:
            raise ValueError(f"widths: expected 2 or more layers, got {tuple(widths)}")
        self.pose: str = pose
        self.scale_mm = scale_mm
        self.raster_shape = (int(raster_shape[0]), int(raster_shape[1]))
        self.half_length = half_length_mm / scale_mm
        inputs = [pose_channels(pose), *widths[:-1]]
        self.layers = nnx.List(
            [AEdgeConv(c, d, k=k, attention=attention, rngs=rngs) for c, d in zip(inputs, widths, strict=True)]
        )
        self.shallow = len(widths) // 2
        self.raster = (
            RasterStage(
                (sum(widths[: self.shallow]), sum(widths[self.shallow :])),
                sum(widths),
                extras=2 if pose == "cylinder" else 1,
                width=raster_width,
                enhancement=enhancement,
                fusion=fusion,
                rngs=rngs,
            )
            if enhancement or fusion
            else None
        )
        self.shared = PooledLayer(sum(widths), shared_width, rngs=rngs)
        self.classifier = Classifier(2 * shared_width, tuple(head), num_classes, dropout=dropout, rngs=rngs)
        self.diameter = DiameterHead((2 * shared_width, *head)[-1], rngs=rngs) if regression else None

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm; rows where `mask` is False change nothing."""
        return self.classify(pose_clouds(xyz, mask, pose=self.pose, scale_mm=self.scale_mm), mask)

    def classify(self, posed: PosedClouds, mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds that are posed already."""
        return self.classifier(self.pooled(posed, mask))

    def with_diameter(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> SizeEstimate:
        """Logits, and the diameter in mm with its standard deviation.

        Raises:
            ValueError: If the network was built without `regression`.
        """
        if self.diameter is None:
            raise ValueError("with_diameter: expected a network built with regression=True, got one without")
        hidden = self.classifier.last_hidden(
            self.pooled(pose_clouds(xyz, mask, pose=self.pose, scale_mm=self.scale_mm), mask)
        )
        return SizeEstimate(self.classifier.logits(hidden), *self.diameter(hidden))

    def attention_weights(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> list[Float[Array, "b d"]]:
        """The channel weights of each edge convolution for each cloud, `[b, d]` a layer; in evaluation mode."""
        x = pose_clouds(xyz, mask, pose=self.pose, scale_mm=self.scale_mm).features
        found = []
        for layer in self.layers:
            found.append(layer.channel_weights(x, mask))
            x = layer(x, mask)
        return found

    def pooled(self, posed: PosedClouds, mask: Bool[Array, "b n"]) -> Float[Array, "b d"]:
        """The feature of each whole cloud `[b, 2 * shared_width]`."""
        x, maps = posed.features, []
        for layer in self.layers:
            x = layer(x, mask)
            maps.append(x)
        joined = jnp.concatenate(maps, axis=-1)
        if self.raster is not None:
            joined = joined + self._unrolled(maps, posed, mask)
        return self.shared(joined, mask)

    def _unrolled(self, maps: list[Array], posed: PosedClouds, mask: Array) -> Float[Array, "b n d"]:
        """The share of the raster stage in the points' features."""
        assert self.raster is not None
        shape = self.raster_shape
        taps = jax.vmap(lambda s, a, m: raster_taps(s, a, m, shape=shape, half_length=self.half_length))(
            posed.axial, posed.angle, mask
        )
        fitted = (
            [] if posed.radius is None else [posed.radius[..., None]]
        )  # a pose without a fit must not bring it in here
        points = jnp.concatenate([*maps, *fitted], axis=-1)
        grid, occupancy = jax.vmap(lambda f, t: cylinder_raster(f, t, shape=shape))(points, taps)
        occupancy = occupancy / jnp.maximum(jnp.sum(occupancy, axis=(1, 2), keepdims=True), 1.0) * occupancy[0].size
        ends = [sum(each.shape[-1] for each in maps[:count]) for count in (self.shallow, len(maps))]
        shallow, deep, radius = jnp.split(grid, ends, axis=-1)
        extras = jnp.concatenate([radius, occupancy[..., None]], axis=-1)
        return jax.vmap(sample_raster)(self.raster(shallow, deep, extras), taps)


class RasterStage(nnx.Module):
    """Enhancement of a shallow and a deep map, then their fusion; either can be left out.

    Args:
        in_features: Channels of the shallow and of the deep map.
        features: Channels of the result.
        extras: Channels beside each map: how densely the cells are filled, and the fitted radius where there is a fit.
        width: Channels of the convolutions in between.
        enhancement: Whether the maps are enhanced.
        fusion: Whether they are fused by dilated branches; if not, by a 1x1 convolution alone.
    """

    def __init__(
        self,
        in_features: tuple[int, int],
        features: int,
        *,
        extras: int,
        width: int,
        enhancement: bool,
        fusion: bool,
        rngs: nnx.Rngs,
    ):
        shallow, deep = (each + extras for each in in_features)
        self.enhance_shallow = FeatureEnhancement(shallow, width, rngs=rngs) if enhancement else None
        self.enhance_deep = FeatureEnhancement(deep, width, rngs=rngs) if enhancement else None
        joined = 2 * width if enhancement else shallow + deep
        self.fuse = FeatureFusion(joined, features, width=width, rngs=rngs) if fusion else None
        self.mix = None if fusion else nnx.Linear(joined, features, kernel_init=lecun_normal, rngs=rngs)

    def __call__(
        self, shallow: Float[Array, "b h w c"], deep: Float[Array, "b h w d"], extras: Float[Array, "b h w e"]
    ) -> Float[Array, "b h w f"]:
        """The raster's features, for the points to sample."""
        maps = [jnp.concatenate([each, extras], axis=-1) for each in (shallow, deep)]
        if self.enhance_shallow is not None and self.enhance_deep is not None:
            maps = [self.enhance_shallow(maps[0]), self.enhance_deep(maps[1])]
        if self.fuse is not None:
            return self.fuse(maps)
        assert self.mix is not None
        return self.mix(jnp.concatenate(maps, axis=-1))
