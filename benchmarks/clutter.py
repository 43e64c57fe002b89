"""Whether a search that draws other random samples gives the same answer: cluttered scenes measured with seeds 0 to 4.

    CABLEJAX_DATA=... python -m benchmarks.clutter --out results/benchmarks/clutter.json

Ten simulated tables on which a cable of 12 to 45 mm holds 10 to 45 % of the points, among crates, cans, a wall and points
anywhere; and with CABLEJAX_DATA ten real scenes: mugs on a table, bins of pins, boxes. A scene's answers are "one", the same from
every seed; "refused" by all; "says so" where they differ and all that stand against another carry a warning that the searches
disagree; "in part" where some are refused and the others alike; and "differ" where two differ and one of them does not say so.
Each scene goes to a file of lines beside the result, and a run that was stopped goes on from there.
"""

import argparse
import json
import os
import time
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import record
from cablejax.io import read_points
from cablejax.measure import CableMeasurement, MeasureError, MeasureSettings, measure_cable
from cablejax.measure.agree import alike

SCENES = 10
FIRST_KEY = 40_000
POINTS = 40_000
LEAST, MOST = 0.1, 0.45  # of the points on the cable
DISAGREE = ("One search of three", "Two searches")  # how the warnings begin (cablejax.measure.messages)
REAL = (
    "6dof_blue_mug_raw", "6dof_cylinder_raw", "6dof_pepper_raw", "6dof_red_mug_raw", "m2vip_dlo", "mosd10_boxes",
    "posecnn2_scene", "zivid_keymatchnet", "zivid_wrs14_pins", "zivid_wrs14_shafts",
)  # fmt: skip


class Clutter(NamedTuple):
    """A scene: its name, points `[n, 3]`, the cable's diameter where one is known, and which points are the cable's `[n]`."""

    name: str
    xyz: np.ndarray
    diameter_mm: float | None = None
    on_cable: np.ndarray | None = None


def _tube(rng: np.random.Generator, n: int, *, diameter: float, length: float, bend: float) -> np.ndarray:
    """The upper side of a cable that bends in the plane, with its middle at the origin."""
    s, angle = rng.uniform(-0.5, 0.5, n) * length, rng.uniform(0.0, np.pi, n)
    turn = s / bend
    middle = np.stack([bend * np.sin(turn), bend * (1 - np.cos(turn)), 0 * s], axis=1)
    across = np.stack([-np.sin(turn), np.cos(turn), 0 * s], axis=1)
    return middle + 0.5 * diameter * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * [0.0, 0.0, 1.0])


def _crate(rng: np.random.Generator, n: int) -> np.ndarray:
    """Three faces of a box that meet in a corner."""
    size = rng.uniform(40.0, 150.0, 3)
    xyz = rng.uniform(0.0, 1.0, (n, 3)) * size
    face = rng.choice(
        3, n, p=np.array([size[1] * size[2], size[2] * size[0], size[0] * size[1]]) / np.sum(np.prod(size) / size)
    )
    xyz[np.arange(n), face] = 0.0
    return _turned(rng, xyz - 0.5 * size)


def _can(rng: np.random.Generator, n: int) -> np.ndarray:
    """Half of a can's side, and of its lid, seen from one side."""
    radius, height = rng.uniform(25.0, 50.0), rng.uniform(60.0, 140.0)
    angle, lid = rng.uniform(0.0, np.pi, n), rng.uniform(size=n) < 0.25
    rho = np.where(lid, radius * np.sqrt(rng.uniform(size=n)), radius)
    up = np.where(lid, height, rng.uniform(0.0, height, n))
    return _turned(rng, np.stack([rho * np.cos(angle), rho * np.sin(angle), up], axis=1))


def _turned(rng: np.random.Generator, xyz: np.ndarray) -> np.ndarray:
    """Turned anyhow and moved to the side of the cable, above the floor."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    side = rng.choice([-1.0, 1.0])
    return xyz @ turn + [rng.uniform(-200.0, 200.0), side * rng.uniform(90.0, 260.0), rng.uniform(40.0, 160.0)]


def simulated() -> Iterator[Clutter]:
    """Ten tables with a cable, two to four crates, one or two cans, a wall, and points anywhere."""
    for number in range(SCENES):
        rng = np.random.default_rng(FIRST_KEY + number)
        diameter = rng.uniform(12.0, 45.0)
        share = rng.uniform(LEAST, MOST)
        cable = _tube(
            rng, int(share * POINTS), diameter=diameter, length=rng.uniform(250.0, 600.0), bend=diameter * rng.uniform(12.0, 60.0)
        )  # fmt: skip
        makers = [_crate] * int(rng.integers(2, 5)) + [_can] * int(rng.integers(1, 3))
        each = int((0.95 - share) * POINTS / (len(makers) + 2))
        flat = rng.uniform(-400.0, 400.0, (2 * each, 3))
        flat[:each, 2] = -0.5 * diameter  # the table that the cable lies on, and a wall behind
        flat[each:, 1] = 400.0
        stray = rng.uniform(-400.0, 400.0, (int(0.05 * POINTS), 3))
        xyz = np.concatenate([cable, *(make(rng, each) for make in makers), flat, stray])
        xyz += rng.uniform(0.1, 0.6) * rng.normal(size=xyz.shape)
        yield Clutter(f"table {number}", xyz, diameter, np.arange(len(xyz)) < len(cable))


def real(folder: Path) -> Iterator[Clutter]:
    """The real scenes."""
    for name in REAL:
        yield Clutter(name, read_points(folder / f"{name}.ply", unit="mm").xyz_mm)


def answers(scene: Clutter, seeds: Sequence[int]) -> tuple[list[dict[str, Any]], list[CableMeasurement | None]]:
    """A row and a measurement for every seed; None where it was refused."""
    rows: list[dict[str, Any]] = []
    found: list[CableMeasurement | None] = []
    for seed in seeds:
        start = time.perf_counter()
        row: dict[str, Any] = {"scene": scene.name, "seed": seed, "true_mm": scene.diameter_mm}
        try:
            one = measure_cable(scene.xyz, settings=MeasureSettings(seed=seed))
        except MeasureError as error:
            one = None
            row["refused"] = str(error)
        if one is not None:
            low, high = one.interval_mm
            row |= {
                "diameter_mm": one.diameter_mm,
                "interval_mm": [low, high],
                "form": one.form,
                "says_so": warned(one),
            }
            if scene.on_cable is not None and scene.diameter_mm is not None:
                row |= {
                    "on_cable": float(scene.on_cable[one.keep].mean()),
                    "holds": bool(low <= scene.diameter_mm <= high),
                }
        rows.append({**row, "seconds": time.perf_counter() - start})
        found.append(one)
    return rows, found


def warned(one: CableMeasurement) -> bool:
    """Whether a result says that the searches did not agree."""
    return any(warning.startswith(DISAGREE) for warning in one.warnings)


def verdict(found: Sequence[CableMeasurement | None]) -> str:
    """What the answers of several seeds are worth: see the module."""
    told = [one for one in found if one is not None]
    if not told:
        return "refused"
    apart = [(a, b) for a, b in combinations(told, 2) if not alike(a, b) and not alike(b, a)]
    if any(not warned(a) and not warned(b) for a, b in apart):
        return "differ"
    if apart:
        return "says so"
    return "one" if len(told) == len(found) else "in part"


def main() -> None:
    """Measure, print, and write the table if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--kinds", nargs="+", choices=("simulated", "real"), default=("simulated", "real"))
    parser.add_argument("--only", help="the scenes whose names hold this")
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    folder = Path(os.environ.get("CABLEJAX_DATA", "../shared/data")) / "real"
    scenes: list[tuple[str, Clutter]] = []
    if "simulated" in options.kinds:
        scenes += [("simulated", one) for one in simulated()]
    if "real" in options.kinds and folder.is_dir():
        scenes += [("real", one) for one in real(folder)]
    lines = Path(options.out).with_suffix(".jsonl") if options.out else None
    done = [json.loads(line) for line in lines.read_text().splitlines()] if lines and lines.is_file() else []
    for kind, scene in scenes:
        if (options.only and options.only not in scene.name) or any(one["scene"] == scene.name for one in done):
            continue
        mine, found = answers(scene, range(options.seeds))
        done.append({"kind": kind, "scene": scene.name, "verdict": verdict(found), "answers": mine})
        if lines:
            with lines.open("a") as stream:
                stream.write(json.dumps(done[-1]) + "\n")
        told = ", ".join(
            f"{row['diameter_mm']:.4g}{'?' if row['says_so'] else ''}" if "diameter_mm" in row else row["refused"][:24]
            for row in mine
        )
        seconds = sum(row["seconds"] for row in mine)
        print(
            f"{scene.name:20s} {done[-1]['verdict']:8s} {seconds:6.1f} s  true {scene.diameter_mm}: {told}",
            flush=True,
        )
    if options.out:
        config = {"points": POINTS, "first_key": FIRST_KEY}
        verdicts = [{name: one[name] for name in ("kind", "scene", "verdict")} for one in done]
        rows = [row for one in done for row in one["answers"]]
        tables = {"scenes": record.table(verdicts, config=config), "answers": record.table(rows)}
        record.write(options.out, tables, seeds=range(options.seeds), config=config)


if __name__ == "__main__":
    main()
