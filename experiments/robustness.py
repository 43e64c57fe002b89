"""How a network trained on `standard` clouds fares on clouds that are worse, each in one respect at a time.

python -m experiments.robustness

The cylinder fit beside it says how much of the fall is the data's.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from cablejax.ops import cylinder_frame
from cablejax.simulate import Split
from cablejax.train import evaluate
from experiments.harness import app
from experiments.harness.schema import Config
from experiments.material.baseline import baseline
from experiments.material.training import clouds_of, fitted, held_out

NOISE_MM = (0.0, 0.1, 0.2, 0.4, 0.8)
KEPT = (1.0, 0.75, 0.5, 0.25)
HOLE_MM = (0.0, 10.0, 20.0, 30.0)
ARC_DEG = (360.0, 180.0, 120.0, 90.0)
VERSIONS = ("clean", "standard", "real-like", "hard")


class Condition(NamedTuple):
    """One way and degree of making clouds worse: "noise_mm", "kept", "hole_mm", "arc_deg" or "version"."""

    kind: str
    level: float | str


CONDITIONS = tuple(
    Condition(kind, level)
    for kind, levels in (
        ("noise_mm", NOISE_MM),
        ("kept", KEPT),
        ("hole_mm", HOLE_MM),
        ("arc_deg", ARC_DEG),
        ("version", VERSIONS),
    )
    for level in levels
)


def worsen(split: Split, condition: Condition, *, key: jax.Array) -> Split:
    """A split with noise added in all directions, or points taken away: at random, in a sphere, or outside an arc.

    Sphere and arc lie about a point of the cloud, drawn at random.

    Args:
        split: Clouds in mm.
        condition: Kind and level; noise and sphere's radius in mm, share of the points kept, arc in degrees.
        key: Consumed.

    Raises:
        ValueError: If the kind is none of the four.
    """
    xyz, mask, level = jnp.asarray(split.xyz), jnp.asarray(split.mask), float(condition.level)
    if condition.kind == "noise_mm":
        return split._replace(xyz=xyz + level * jax.random.normal(key, xyz.shape) * mask[..., None])
    if condition.kind == "kept":
        return split._replace(mask=mask & (jax.random.uniform(key, mask.shape) < level))
    middle = jax.random.categorical(key, jnp.where(mask, 0.0, -jnp.inf), axis=1)[:, None]
    if condition.kind == "hole_mm":
        centre = jnp.take_along_axis(xyz, middle[..., None], axis=1)
        return split._replace(mask=mask & (jnp.square(xyz - centre).sum(axis=-1) >= level**2))
    if condition.kind == "arc_deg":
        angle = jax.lax.map(lambda cloud: cylinder_frame(*cloud).angle, (xyz, mask))
        apart = jnp.abs(jnp.mod(angle - jnp.take_along_axis(angle, middle, axis=1) + jnp.pi, 2 * jnp.pi) - jnp.pi)
        return split._replace(mask=mask & (apart <= jnp.radians(level) / 2))
    raise ValueError(f"condition: expected noise_mm, kept, hole_mm or arc_deg, got {condition.kind!r}")


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train once, then evaluate the test split under every condition; nothing is chosen here."""
    result = fitted(cfg, folder)
    key = jax.random.fold_in(jax.random.key(cfg.dataset.seed), cfg.seed)
    diameters = clouds_of(cfg.dataset, 1).diameters_mm
    rows = []
    for i, condition in enumerate(CONDITIONS):
        if condition.kind == "version":
            split = held_out(replace(cfg, dataset=replace(cfg.dataset, version=str(condition.level))), "test")
        else:
            split = worsen(held_out(cfg, "test"), condition, key=jax.random.fold_in(key, i))
        fit = baseline(split, diameters)["baseline_overall"]
        rows.append({**condition._asdict(), "network": evaluate(result.model, split).overall, "fit": fit})
    return {"conditions": rows, "validation_overall": result.history[result.best_epoch - 1].validation_overall}


def headline(metrics: dict[str, Any]) -> str:
    worst = min(metrics["conditions"], key=lambda row: row["network"])
    first = metrics["conditions"][0]["network"]
    return f"accuracy {first:.3f}, at worst {worst['network']:.3f} ({worst['kind']} {worst['level']})"


if __name__ == "__main__":
    app.main(run, experiment="robustness", headline=headline)
