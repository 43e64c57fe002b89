"""Edge convolution against an edge-by-edge float64 reference and against literal autodiff."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops.edges import (
    AttentionWeights,
    channel_attention,
    edge_attention,
    edge_conv,
    edge_features,
    edge_products,
    edge_statistics,
    neighbor_max,
    neighbor_sum,
)
from cablejax.ops.maximum import largest
from tests.reference import edges as reference

N, K, C, D, H = 24, 5, 4, 8, 4


def sample(seed=0, channels=C):
    rng = np.random.default_rng(seed)
    mask = np.ones(N, bool)
    mask[[3, 20]] = False
    weights = [rng.normal(size=s) for s in ((D, H), (H,), (H, D), (D,))]
    return {
        "features": rng.normal(size=(N, channels)),
        "mask": mask,
        "kernel": rng.normal(size=(2 * channels, D)),
        "scale": rng.normal(size=D),  # both signs: a negative scale turns the maximum into a minimum
        "shift": rng.normal(size=D),
        "weights": weights,
    }


def f32(array):
    return jnp.asarray(array, jnp.float32)


@pytest.mark.parametrize("attention", [False, True])
def test_edge_conv_equals_the_reference(attention):
    data = sample(2)
    graph = reference.graph(data["features"], K, data["mask"])
    graph[5, 2:] = -1  # a point that misses neighbours
    weights = AttentionWeights(*map(f32, data["weights"])) if attention else None
    arguments = {name: f32(data[name]) for name in ("scale", "shift")}
    found = edge_conv(f32(data["features"]), jnp.asarray(graph), f32(data["kernel"]), attention=weights, **arguments)
    expected = reference.edge_conv(
        data["features"], graph, data["kernel"], data["scale"], data["shift"], data["weights"] if attention else None
    )
    # Sums of 8 products of order 1 to 10 in float32.
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_attention_to_look_at_is_equation_12():
    data = sample(2)
    graph = reference.graph(data["features"], K, data["mask"])
    graph[5, 2:] = -1
    weights, scale, shift = AttentionWeights(*map(f32, data["weights"])), f32(data["scale"]), f32(data["shift"])
    shares = edge_products(f32(data["features"]), f32(data["kernel"]))
    found = edge_attention(*shares, jnp.asarray(graph), scale=scale, shift=shift, attention=weights)
    edges = edge_features(f32(data["features"]), jnp.asarray(graph)) @ f32(data["kernel"])
    edges = edges * scale[None, None, :] + shift[None, None, :]
    np.testing.assert_allclose(found, channel_attention(edges, jnp.asarray(graph >= 0), weights), rtol=1e-4)


def literal(features, kernel, scale, shift, weights, graph):
    """Eqs. (11)-(14) as they stand, with a tensor per edge."""
    valid = graph >= 0
    edges = (edge_features(features, graph) @ kernel) * scale[None, None, :] + shift[None, None, :]
    edges = edges * channel_attention(edges, valid, weights)[None, None, :]
    best = largest(jnp.where(valid[:, :, None], edges, -jnp.inf), 1)
    return jax.nn.leaky_relu(jnp.where(valid[:, :1], best, 0.0), 0.2)


def fast(features, kernel, scale, shift, weights, graph):
    return edge_conv(features, graph, kernel, scale=scale, shift=shift, attention=weights)


def test_gradients_equal_those_of_the_literal_form():
    clouds = [sample(seed) for seed in (3, 4)]
    graphs = jnp.stack([jnp.asarray(reference.graph(each["features"], K, each["mask"])) for each in clouds])
    features = jnp.stack([f32(each["features"]) for each in clouds])
    shared = [f32(clouds[0][name]) for name in ("kernel", "scale", "shift")]
    shared.append(AttentionWeights(*map(f32, clouds[0]["weights"])))
    target = jax.random.normal(jax.random.key(0), (2, N, D))

    def loss(form, features, *shared):
        out = jax.vmap(form, in_axes=(0, None, None, None, None, 0))(features, *shared, graphs)
        return jnp.sum(out * target)

    found, expected = (
        jax.jit(jax.grad(partial(loss, form), argnums=(0, 1, 2, 3, 4)))(features, *shared) for form in (fast, literal)
    )
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-4, atol=2e-4 * float(jnp.abs(b).max()))


def test_gradients_equal_differences_of_the_reference():
    """Along a random direction of each argument, against central differences of the float64 edge-by-edge form."""
    data, rng = sample(7), np.random.default_rng(8)
    graph = reference.graph(data["features"], K, data["mask"])
    target = rng.normal(size=(N, D))
    arguments = [data["features"], data["kernel"], data["scale"], data["shift"], data["weights"]]

    def loss(features, kernel, scale, shift, weights):
        return np.sum(reference.edge_conv(features, graph, kernel, scale, shift, weights) * target)

    def ours(features, kernel, scale, shift, weights):
        return jnp.sum(fast(features, kernel, scale, shift, AttentionWeights(*weights), jnp.asarray(graph)) * target)

    gradients = jax.jit(jax.grad(ours, argnums=(0, 1, 2, 3, 4)))(*jax.tree.map(f32, arguments))
    leaves, tree = jax.tree.flatten(arguments)
    for index, gradient in enumerate(jax.tree.leaves(gradients)):
        direction, step = rng.normal(size=leaves[index].shape), 1e-6

        def moved(amount, index=index, direction=direction):
            shifted = [leaf + amount * direction if i == index else leaf for i, leaf in enumerate(leaves)]
            return loss(*jax.tree.unflatten(tree, shifted))

        slope = (moved(step) - moved(-step)) / (2 * step)
        scale = np.linalg.norm(gradient) * np.linalg.norm(direction)
        # Sums of thousands of float32 products; the slope's own error is 1e-9 of the loss over the step, about 1e-3.
        assert float(np.sum(np.asarray(gradient, np.float64) * direction)) == pytest.approx(
            slope, abs=1e-4 * scale + 5e-3
        )


def test_statistics_equal_those_over_all_edges_far_from_zero():
    clouds = [sample(seed) for seed in (5, 6)]
    graphs = [reference.graph(each["features"], K, each["mask"]) for each in clouds]
    rng = np.random.default_rng(0)
    center, neighbor = rng.normal(size=(2, 2, N, D)) + 100.0
    edges = np.concatenate(
        [
            [center[b, i] + neighbor[b, j] for i, row in enumerate(graph) for j in row if j >= 0]
            for b, graph in enumerate(graphs)
        ]
    )
    mean, var = edge_statistics(f32(center), f32(neighbor), jnp.asarray(np.stack(graphs)))
    np.testing.assert_allclose(mean, edges.mean(axis=0), rtol=1e-5)
    # E[x^2] - E[x]^2 would be wrong here in the second digit: 40,000 against a variance of 2.
    np.testing.assert_allclose(var, edges.var(axis=0), rtol=1e-4)


def test_neighbor_max_and_sum_under_jit_vmap_and_without_neighbours():
    values = jax.random.normal(jax.random.key(1), (3, N, D))
    graph = jax.random.randint(jax.random.key(2), (3, N, K), -1, N).at[:, 0].set(-1)
    for kernel in (neighbor_max, neighbor_sum):
        batched = jax.jit(jax.vmap(kernel))(values, graph)
        loop = jnp.stack([kernel(v, g) for v, g in zip(values, graph, strict=True)])
        np.testing.assert_array_equal(batched, loop)
    assert bool((neighbor_max(values[0], graph[0])[0] == -jnp.inf).all())
    assert bool((neighbor_sum(values[0], graph[0])[0] == 0).all())


def test_max_sends_the_gradient_of_a_tie_to_the_first_neighbour():
    grad = jax.grad(lambda v: neighbor_max(v, jnp.array([[2, 1], [1, 2], [0, 0]]))[:2].sum())(jnp.ones((3, 1)))
    np.testing.assert_array_equal(grad[:, 0], [0.0, 1.0, 1.0])


def test_no_tensor_per_edge_is_kept():
    """The compiled gradient's temporary memory stays below one `[b, n, k, d]` tensor."""
    b, n, k, d = 4, 128, 20, 64

    def loss(center, neighbor, graph):
        mean, var = edge_statistics(center, neighbor, graph)
        scale = jax.lax.rsqrt(var + 1e-5)
        out = jax.vmap(partial(edge_conv_shares, scale=scale, shift=-mean * scale))(center, neighbor, graph)
        return jnp.sum(out**2)

    from cablejax.ops.edges import aggregate_edges as edge_conv_shares

    shape = jax.ShapeDtypeStruct((b, n, d), jnp.float32)
    graph = jax.ShapeDtypeStruct((b, n, k), jnp.int32)
    compiled = jax.jit(jax.grad(loss, argnums=(0, 1))).lower(shape, shape, graph).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < b * n * k * d * 4
