"""One edge convolution beside the same in PyTorch and literally in JAX: `python -m benchmarks.edgeconv`.

Graph, edge features, batch statistics, channel attention and maximum, forward and with all gradients, on one batch. All
contenders start from the same features and weights, and their values are compared before any is timed.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import alternate

RESULT = Path("results/benchmarks")


def inputs(options: argparse.Namespace) -> tuple[np.ndarray, ...]:
    """Features `[b, n, c]`, kernel `[2c, d]`, and a cotangent `[b, n, d]`."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(options.clouds, options.points, options.channels))
    kernel = rng.normal(size=(2 * options.channels, options.width)) / options.channels**0.5
    cotangent = rng.normal(size=(*features.shape[:2], options.width))
    return tuple(each.astype(np.float32) for each in (features, kernel, cotangent))


def of_jax(features: np.ndarray, kernel: np.ndarray, cotangent: np.ndarray, *, k: int, literal: bool):
    """`(forward, gradient)` of the factorised layer, or of eqs. (11)-(14) with a tensor per edge."""
    import jax
    import jax.numpy as jnp

    from cablejax.ops import edge_features, feature_graph
    from cablejax.ops.edges import aggregate_edges, edge_products, edge_statistics

    def factorised(x, w):
        graph = jax.vmap(lambda rows: feature_graph(rows, k=k))(x)
        center, neighbor = jax.vmap(edge_products, in_axes=(0, None))(x, w)
        mean, var = edge_statistics(center, neighbor, graph)
        scale = jax.lax.rsqrt(var + 1e-5)
        return jax.vmap(lambda c, n, g: aggregate_edges(c, n, g, scale=scale, shift=-mean * scale))(
            center, neighbor, graph
        )

    def by_edges(x, w):
        graph = jax.vmap(lambda rows: feature_graph(rows, k=k))(x)
        edges = jax.vmap(edge_features)(x, graph) @ w
        mean, var = edges.mean(axis=(0, 1, 2)), edges.var(axis=(0, 1, 2))
        edges = (edges - mean[None, None, None]) * jax.lax.rsqrt(var + 1e-5)[None, None, None]
        return jax.nn.leaky_relu(edges.max(axis=2), 0.2)

    layer = by_edges if literal else factorised
    x, w, ct = map(jnp.asarray, (features, kernel, cotangent))
    forward = jax.jit(layer)
    gradient = jax.jit(jax.grad(lambda x, w: jnp.sum(layer(x, w) * ct), argnums=(0, 1)))
    return lambda: np.asarray(forward(x, w)), lambda: [np.asarray(each) for each in gradient(x, w)]


def of_torch(features: np.ndarray, kernel: np.ndarray, cotangent: np.ndarray, *, k: int):
    """`(forward, gradient)` of the layer in PyTorch, eager."""
    import torch

    from benchmarks.torch_nets import AEdgeConv

    layer = AEdgeConv(features.shape[2], kernel.shape[1], k=k, attention=False)
    layer.kernel.data = torch.from_numpy(kernel)
    x, ct = torch.from_numpy(features).requires_grad_(), torch.from_numpy(cotangent)

    def forward() -> np.ndarray:
        with torch.inference_mode():
            return layer(x).numpy()

    def gradient() -> list[np.ndarray]:
        x.grad = layer.kernel.grad = None
        (layer(x) * ct).sum().backward()
        assert x.grad is not None
        assert layer.kernel.grad is not None
        return [x.grad.numpy(), layer.kernel.grad.numpy()]

    return forward, gradient


def title_of(kind: str) -> str:
    """Name of the table."""
    return f"edgeconv_{kind}"


def main() -> None:
    """Check that all agree, time them in turn, print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, value in {"clouds": 16, "points": 1024, "channels": 64, "width": 128, "k": 20, "rounds": 7}.items():
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--write", action="store_true", help=f"write to {RESULT}; leave it out on a busy machine")
    options = parser.parse_args()
    arrays = inputs(options)
    contenders: dict[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
        "cablejax": of_jax(*arrays, k=options.k, literal=False),
        "jax, edge by edge": of_jax(*arrays, k=options.k, literal=True),
        "torch": of_torch(*arrays, k=options.k),
    }
    for index, kind in enumerate(("forward", "gradient")):
        runs, values, first = {name: both[index] for name, both in contenders.items()}, {}, {}
        for name, run in runs.items():
            start = time.perf_counter()
            values[name] = run()
            first[name] = time.perf_counter() - start
        for name, value in values.items():
            # A neighbour that is as far as another to within rounding may be swapped: few entries, not their sizes.
            off = max(
                float(np.mean(np.abs(a - b) > 1e-3 * np.abs(a).max()))
                for a, b in zip(values["torch"], value, strict=True)
            )
            print(f"{title_of(kind)}: {name}: {off:.1e} of the entries differ from torch's by more than 0.1 %")
            assert off < 1e-3 or name != "cablejax"
        title = title_of(kind)
        alternate(title, runs, first, vars(options), RESULT / f"{title}.json" if options.write else None)


if __name__ == "__main__":
    main()
