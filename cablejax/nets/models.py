"""Networks by name."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import jax
from flax import nnx

from cablejax.nets.adgcnn import ADGCNN
from cablejax.nets.adgcnn_fit import ADGCNNFit
from cablejax.nets.baselines import DGCNN, VGG16, AlexNet, PointNet, PointNet2, PointNeXt, ResNet50

MODELS: Mapping[str, Callable[..., nnx.Module]] = MappingProxyType(
    {
        "adgcnn": ADGCNN,
        "adgcnn_fit": ADGCNNFit,
        "dgcnn": DGCNN,
        "pointnet": PointNet,
        "pointnet2": PointNet2,
        "pointnext": PointNeXt,
        "alexnet": AlexNet,
        "vgg16": VGG16,
        "resnet50": ResNet50,
    }
)


def build_model(name: str, num_classes: int, *, rngs: nnx.Rngs, **options: Any) -> nnx.Module:
    """A network, called as `(xyz [b, n, 3] mm, mask [b, n]) -> logits [b, num_classes]`.

    Args:
        name: One of `MODELS`.
        num_classes: Classes C.
        rngs: Consumed for the initial weights, kept for dropout.
        **options: The network's own keyword arguments.

    Raises:
        ValueError: If the name or an option is unknown.

    Example:
        >>> import jax.numpy as jnp
        >>> model = build_model("pointnet", 13, rngs=nnx.Rngs(0))
        >>> model.eval()
        >>> model(jnp.ones((2, 16, 3)), jnp.ones((2, 16), dtype=bool)).shape
        (2, 13)
    """
    if name not in MODELS:
        raise ValueError(f"name: expected one of {', '.join(MODELS)}, got {name!r}")
    try:
        return MODELS[name](num_classes, rngs=rngs, **options)
    except TypeError as error:
        raise ValueError(f"options: {name}: {error}") from error


def count_parameters(model: nnx.Module) -> int:
    """Trainable numbers of a model, batch-norm scales and offsets included, running statistics not."""
    return sum(leaf.size for leaf in jax.tree.leaves(nnx.state(model, nnx.Param)))
