"""VGG-16 (Simonyan, Zisserman 2015, configuration D) on a depth image."""

import jax
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.depth import Size, render, sides
from cablejax.nets.init import he_normal, lecun_normal

BLOCKS = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))


class VGG16(nnx.Module):
    """Thirteen 3x3 convolutions in five blocks, three fully connected layers; no batch normalisation, as published.

    Departures: one input channel (depth) instead of three; the image is of `size` pixels, and the first fully
    connected layer takes as many inputs as that leaves (25,088 at 224); all weights start at He's variance, where the
    publication started deep nets from trained shallow ones; C outputs. At 224 pixels, three channels and 1,000 classes
    it has the published 138,357,544 parameters.

    Args:
        num_classes: C.
        size: Pixels of the image's side, or rows and columns, at least 32 each.
        extent_mm: Width of what the image shows, see `depth_image`.
        in_channels: Channels of the image.
        dropout: Rate after the first two fully connected layers.
    """

    def __init__(
        self,
        num_classes: int,
        *,
        size: Size = 64,
        extent_mm: float = 128.0,
        in_channels: int = 1,
        dropout: float = 0.5,
        rngs: nnx.Rngs,
    ):
        rows, columns = sides(size)
        if min(rows, columns) < 32:
            raise ValueError(f"size: VGG-16's five halvings need at least 32 pixels, got {size}")
        self.size, self.extent_mm = (rows, columns), extent_mm
        blocks, channels = [], in_channels
        for widths in BLOCKS:
            convs = []
            for width in widths:
                convs.append(nnx.Conv(channels, width, (3, 3), padding=1, kernel_init=he_normal, rngs=rngs))
                channels = width
            blocks.append(nnx.List(convs))
        self.blocks = nnx.List(blocks)
        self.fc6 = nnx.Linear(512 * (rows // 32) * (columns // 32), 4096, kernel_init=he_normal, rngs=rngs)
        self.fc7 = nnx.Linear(4096, 4096, kernel_init=he_normal, rngs=rngs)
        self.fc8 = nnx.Linear(4096, num_classes, kernel_init=lecun_normal, rngs=rngs)
        self.dropout = nnx.Dropout(dropout, rngs=rngs)

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm."""
        return self.from_image(render(xyz, mask, size=self.size, extent_mm=self.extent_mm))

    def from_image(self, image: Float[Array, "b h w c"]) -> Float[Array, "b classes"]:
        """Logits of images `[b, rows, columns, in_channels]`."""
        x = image
        for block in self.blocks:
            for conv in block:
                x = jax.nn.relu(conv(x))
            x = nnx.max_pool(x, (2, 2), strides=(2, 2))
        x = self.dropout(jax.nn.relu(self.fc6(x.reshape(x.shape[0], -1))))
        return self.fc8(self.dropout(jax.nn.relu(self.fc7(x))))
