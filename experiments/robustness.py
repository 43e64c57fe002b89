"""How a network trained on `standard` clouds fares on clouds that are worse, each in one respect at a time.

python -m experiments.robustness
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from cablejax.simulate import Split
from cablejax.train import evaluate
from experiments import app
from experiments.schema import Config
from experiments.train import fitted, held_out

NOISE_MM = (0.0, 0.1, 0.2, 0.4, 0.8)
KEPT = (1.0, 0.75, 0.5, 0.25)
HOLE_MM = (0.0, 10.0, 20.0, 30.0)
VERSIONS = ("clean", "standard", "real-like", "hard")


class Condition(NamedTuple):
    """One way and degree of making clouds worse: "noise_mm", "kept", "hole_mm" or "version"."""

    kind: str
    level: float | str


CONDITIONS = tuple(
    Condition(kind, level)
    for kind, levels in (("noise_mm", NOISE_MM), ("kept", KEPT), ("hole_mm", HOLE_MM), ("version", VERSIONS))
    for level in levels
)


def worsen(split: Split, condition: Condition, *, key: jax.Array) -> Split:
    """A split with noise added in all directions, points taken away at random, or those within a sphere about a point.

    Args:
        split: Clouds in mm.
        condition: Kind and level; noise and sphere's radius in mm, share of the points kept.
        key: Consumed.

    Raises:
        ValueError: If the kind is none of the three.
    """
    xyz, mask, level = jnp.asarray(split.xyz), jnp.asarray(split.mask), float(condition.level)
    if condition.kind == "noise_mm":
        return split._replace(xyz=xyz + level * jax.random.normal(key, xyz.shape) * mask[..., None])
    if condition.kind == "kept":
        return split._replace(mask=mask & (jax.random.uniform(key, mask.shape) < level))
    if condition.kind == "hole_mm":
        middle = jax.random.categorical(key, jnp.where(mask, 0.0, -jnp.inf), axis=1)
        centre = jnp.take_along_axis(xyz, middle[:, None, None], axis=1)
        return split._replace(mask=mask & (jnp.square(xyz - centre).sum(axis=-1) >= level**2))
    raise ValueError(f"condition: expected noise_mm, kept or hole_mm, got {condition.kind!r}")


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train once, then evaluate the test split under every condition; nothing is chosen here."""
    result = fitted(cfg, folder)
    key = jax.random.fold_in(jax.random.key(cfg.dataset.seed), cfg.seed)
    rows = []
    for i, condition in enumerate(CONDITIONS):
        if condition.kind == "version":
            split = held_out(replace(cfg, dataset=replace(cfg.dataset, version=str(condition.level))), "test")
        else:
            split = worsen(held_out(cfg, "test"), condition, key=jax.random.fold_in(key, i))
        rows.append({**condition._asdict(), "network": evaluate(result.model, split).overall})
    return {"conditions": rows, "validation_overall": result.history[result.best_epoch - 1].validation_overall}


def headline(metrics: dict[str, Any]) -> str:
    worst = min(metrics["conditions"], key=lambda row: row["network"])
    first = metrics["conditions"][0]["network"]
    return f"accuracy {first:.3f}, at worst {worst['network']:.3f} ({worst['kind']} {worst['level']})"


if __name__ == "__main__":
    app.main(run, experiment="robustness", headline=headline)
