"""What each network costs: parameters, operations, training steps and clouds a second.

    python -m benchmarks.networks --out results/benchmarks/networks.json

All on the same batch of 24 clouds of 256 points, of 13 classes: networks on points without any fit in their input, `adgcnn_fit`
with its own, networks on images with the projection to 64 x 64 pixels in the time. Parameters and operations are counted, not
timed, as in `make tabulate`. Each network is timed by itself: the shortest of ten calls, after two that are not counted.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import jax
from flax import nnx

from benchmarks import record
from benchmarks.train_step import CLASSES, batch, network
from cablejax.nets import build_model
from cablejax.nets.input_channels import RADIUS_MM
from cablejax.nets.models import MODELS, count_parameters
from cablejax.nets.tabulate import flops

CLOUDS, POINTS = 24, 256
ON_POINTS = ("adgcnn", "dgcnn", "pointnet", "pointnet2", "pointnext")
CALLS, UNCOUNTED = 10, 2


def options_of(name: str) -> dict[str, Any]:
    """What a network is built with."""
    if name == "adgcnn_fit":
        return {"diameters_mm": [2.0 * RADIUS_MM] * CLASSES}
    return {"pose": "none"} if name in ON_POINTS else {}


def seconds(call: Callable[[], Any]) -> float:
    """The shortest of a few calls, on the clock."""
    best = float("inf")
    for number in range(UNCOUNTED + CALLS):
        start = time.perf_counter()
        call()
        if number >= UNCOUNTED:
            best = min(best, time.perf_counter() - start)
    return best


def cost(name: str) -> dict[str, Any]:
    """One row."""
    options = options_of(name)
    model = build_model(name, CLASSES, rngs=nnx.Rngs(0), **options)
    row: dict[str, Any] = {"network": name, "parameters": count_parameters(model), "flop": flops(model, POINTS)}
    data = batch(CLOUDS, POINTS)
    if name == "adgcnn_fit":  # it also learns which points are the cable's
        data = (*data, data[1])
    start = time.perf_counter()
    step, infer = network(name, data, **options)
    step()
    row["first_step_s"] = time.perf_counter() - start
    row |= {"step_s": seconds(step), "inference_s": seconds(infer)}
    jax.clear_caches()
    return row


def main() -> None:
    """Time, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(MODELS), default=list(MODELS))
    parser.add_argument("--out", help="JSON file to write")
    options = parser.parse_args()
    jax.config.update("jax_enable_compilation_cache", False)  # the first step is to include compiling
    rows = []
    for name in options.only:
        rows.append(cost(name))
        row = rows[-1]
        counted = f"{row['parameters'] / 1e6:6.2f} M parameters  {row['flop'] / 1e9:6.3f} GFLOP"
        timed = f"step {1e3 * row['step_s']:7.1f} ms  {CLOUDS / row['inference_s']:6.0f} clouds/s"
        print(f"{name:10s} {counted}  {timed}  first step after {row['first_step_s']:.1f} s", flush=True)
    if options.out:
        config = {"clouds": CLOUDS, "points": POINTS, "classes": CLASSES}
        record.write(options.out, {"networks": record.table(rows, config=config)}, config=config)


if __name__ == "__main__":
    main()
