"""DGCNN (Wang et al. 2019), the classification network, on the cloud's points."""

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.aedgeconv import AEdgeConv
from cablejax.nets.head import Classifier, PooledLayer
from cablejax.nets.input_channels import pose_channels, pose_clouds


class DGCNN(nnx.Module):
    """EdgeConv 64, 64, 128, 256, a shared layer of 1,024, max and mean pooling, 512, 256, C.

    Departures: lengths are divided by a constant instead of the cloud's own size, which is the label here; the input
    may be posed like ADGCNN's. With pose "none" and 40 classes it has the 1.8 million parameters of the publication.

    Args:
        num_classes: C.
        k: Neighbours per point, the point itself counted.
        pose: Frame of the input, see `pose_clouds`.
        scale_mm: Length that becomes 1 at the input.
        dropout: Rate in the classifier.
    """

    def __init__(
        self,
        num_classes: int,
        *,
        k: int = 20,
        pose: str = "cylinder",
        scale_mm: float = 20.0,
        dropout: float = 0.5,
        rngs: nnx.Rngs,
    ):
        self.pose: str = pose
        self.scale_mm = scale_mm
        widths = (64, 64, 128, 256)
        inputs = (pose_channels(pose), *widths[:-1])
        self.layers = nnx.List(
            [AEdgeConv(c, d, k=k, attention=False, rngs=rngs) for c, d in zip(inputs, widths, strict=True)]
        )
        self.shared = PooledLayer(sum(widths), 1024, rngs=rngs)
        self.classifier = Classifier(2048, (512, 256), num_classes, dropout=dropout, rngs=rngs)

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm; rows where `mask` is False change nothing."""
        x, maps = pose_clouds(xyz, mask, pose=self.pose, scale_mm=self.scale_mm).features, []
        for layer in self.layers:
            x = layer(x, mask)
            maps.append(x)
        return self.classifier(self.shared(jnp.concatenate(maps, axis=-1), mask))
