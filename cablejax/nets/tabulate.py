"""What a network costs: parameters by part, shapes, and the floating-point operations of one cloud."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx

from cablejax.nets.input_channels import RADIUS_MM
from cablejax.nets.models import MODELS, build_model, count_parameters


class Cost(NamedTuple):
    """One row of a network's table.

    Attributes:
        part: Attribute of the network.
        parameters: Trainable numbers in it.
        shapes: Shapes of its parameters with two axes or more.
    """

    part: str
    parameters: int
    shapes: list[tuple[int, ...]]


def parts(model: nnx.Module) -> list[Cost]:
    """Parameters of each attribute of a network, largest shapes first as they come."""
    leaves: dict[str, list[tuple[int, ...]]] = {}
    for path, leaf in jax.tree.leaves_with_path(nnx.state(model, nnx.Param)):
        name = str(getattr(path[0], "key", path[0]))
        leaves.setdefault(name, []).append(tuple(leaf.shape))
    return [
        Cost(name, sum(math.prod(shape) for shape in shapes), [shape for shape in shapes if len(shape) > 1])
        for name, shapes in leaves.items()
    ]


def flops(model: nnx.Module, n_points: int) -> float:
    """Floating-point operations of one cloud's inference, as XLA counts those of the program it is given.

    The neighbour graph and the cylinder fit are part of it. A loop's body is counted once.
    """
    copy = nnx.merge(*nnx.split(model), copy=True)
    copy.eval()
    graphdef, state = nnx.split(copy)
    cloud = jax.ShapeDtypeStruct((1, n_points, 3), jnp.float32), jax.ShapeDtypeStruct((1, n_points), jnp.bool_)
    lowered = jax.jit(lambda s, x, m: nnx.merge(graphdef, s, copy=True)(x, m)).lower(state, *cloud)
    analysis = lowered.cost_analysis()
    return float(analysis["flops"]) if analysis else float("nan")


def tabulate(name: str, num_classes: int = 13, *, n_points: int = 1024) -> str:
    """A network's table as text.

    Raises:
        ValueError: If the name is unknown.
    """
    options = {"diameters_mm": [2.0 * RADIUS_MM] * num_classes} if name == "adgcnn_fit" else {}  # sizes change no count
    model = build_model(name, num_classes, rngs=nnx.Rngs(0), **options)
    total = count_parameters(model)
    lines = [f"{name}: {total:,} parameters, {flops(model, n_points) / 1e9:.2f} GFLOP a cloud of {n_points} points"]
    for part, parameters, shapes in parts(model):
        shown = " ".join("x".join(map(str, shape)) for shape in shapes[:6]) + (" ..." if len(shapes) > 6 else "")
        lines.append(f"  {part:16s}{parameters:12,d}  {shown}")
    return "\n".join(lines)


def main() -> None:
    """Print the table of every network."""
    for name in MODELS:
        print(tabulate(name), end="\n\n", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
