"""AlexNet (Krizhevsky, Sutskever, Hinton 2012) on a depth image."""

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.depth import Size, render, sides
from cablejax.nets.init import he_normal, lecun_normal


class AlexNet(nnx.Module):
    """The published layer table, both halves of the two-GPU network as two groups.

    Departures: one input channel (depth) instead of three; the image is of `size` pixels, and the first fully
    connected layer takes as many inputs as that leaves (9,216 at 224); weights start at He's variance, not at 0.01;
    C outputs. At 224 pixels, three channels and 1,000 classes it has the published 60,965,224 parameters.

    Args:
        num_classes: C.
        size: Pixels of the image's side, or rows and columns, at least 63 each.
        extent_mm: Width of what the image shows, see `depth_image`.
        in_channels: Channels of the image.
        dropout: Rate before the first two fully connected layers.
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
        if min(rows, columns) < 63:
            raise ValueError(f"size: AlexNet's strides need at least 63 pixels, got {size}")
        self.size, self.extent_mm = (rows, columns), extent_mm

        def conv(c: int, d: int, side: int, *, groups: int = 1, stride: int = 1, padding: int) -> nnx.Conv:
            return nnx.Conv(
                c,
                d,
                (side, side),
                strides=stride,
                padding=padding,
                feature_group_count=groups,
                kernel_init=he_normal,
                rngs=rngs,
            )

        self.conv1 = conv(in_channels, 96, 11, stride=4, padding=2)
        self.conv2 = conv(96, 256, 5, groups=2, padding=2)
        self.conv3 = conv(256, 384, 3, padding=1)
        self.conv4 = conv(384, 384, 3, groups=2, padding=1)
        self.conv5 = conv(384, 256, 3, groups=2, padding=1)
        left = [(side + 4 - 11) // 4 + 1 for side in (rows, columns)]
        for _ in range(3):
            left = [(side - 3) // 2 + 1 for side in left]
        self.fc6 = nnx.Linear(256 * left[0] * left[1], 4096, kernel_init=he_normal, rngs=rngs)
        self.fc7 = nnx.Linear(4096, 4096, kernel_init=he_normal, rngs=rngs)
        self.fc8 = nnx.Linear(4096, num_classes, kernel_init=lecun_normal, rngs=rngs)
        self.dropout = nnx.Dropout(dropout, rngs=rngs)

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm."""
        return self.from_image(render(xyz, mask, size=self.size, extent_mm=self.extent_mm))

    def from_image(self, image: Float[Array, "b h w c"]) -> Float[Array, "b classes"]:
        """Logits of images `[b, rows, columns, in_channels]`."""
        x = max_pool(local_response_norm(jax.nn.relu(self.conv1(image))))
        x = max_pool(local_response_norm(jax.nn.relu(self.conv2(x))))
        x = jax.nn.relu(self.conv4(jax.nn.relu(self.conv3(x))))
        x = max_pool(jax.nn.relu(self.conv5(x)))
        x = self.dropout(x.reshape(x.shape[0], -1))
        x = self.dropout(jax.nn.relu(self.fc6(x)))
        return self.fc8(jax.nn.relu(self.fc7(x)))


def max_pool(x: Float[Array, "b h w c"]) -> Float[Array, "b i j c"]:
    """Overlapping maximum: windows of 3, stride 2."""
    return nnx.max_pool(x, (3, 3), strides=(2, 2))


def local_response_norm(x: Float[Array, "b h w c"]) -> Float[Array, "b h w c"]:
    """Section 3.3 of the publication: `x / (2 + 1e-4 * sum of squares over 5 neighbouring channels) ** 0.75`."""
    squares = jnp.pad(x**2, ((0, 0), (0, 0), (0, 0), (2, 2)))
    total = sum(squares[..., shift : shift + x.shape[-1]] for shift in range(5))
    return x / (2.0 + 1e-4 * total) ** 0.75
