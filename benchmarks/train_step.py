"""A training step and inference of ADGCNN or DGCNN beside the same network in PyTorch: `python -m benchmarks.train_step`.

A step is forward, backward and Adadelta on one batch; our side runs what `cablejax.train.fit` runs, cylinder fit
included, which PyTorch is spared. Both run in this process and take turns. `--memory NAME` runs one side alone and prints
its peak memory, `--first-step` the time from nothing to the first step in fresh processes, without and with a filled
compilation cache.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import alternate

RESULT = Path("results/benchmarks")
CLASSES = 13
FIRST_STEP = """
import time
start = time.perf_counter()
from benchmarks import train_step
train_step.first({!r}, {}, {}, {}, start)
"""


def batch(clouds: int, points: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half-cylinders in mm `[b, n, 3]`, their masks and class numbers."""
    rng = np.random.default_rng(seed)
    label = np.arange(clouds) % CLASSES
    radius = 10.0 + label[:, None] + rng.normal(0, 0.3, (clouds, points))
    angle = rng.uniform(-np.pi / 2, np.pi / 2, (clouds, points))
    xyz = np.stack([rng.uniform(-50, 50, angle.shape), radius * np.cos(angle), radius * np.sin(angle)], axis=2)
    xyz -= xyz.mean(axis=1, keepdims=True)
    return xyz.astype(np.float32), np.ones((clouds, points), bool), label.astype(np.int32)


def ours(name: str, data: tuple[np.ndarray, ...], k: int) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """`(step, infer)` of cablejax, its cylinder fit included."""
    return network(name, data, k=k, **({} if name == "adgcnn" else {"dropout": 0.0}))


def network(name: str, data: tuple[np.ndarray, ...], **options: Any) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """`(step, infer)` of a network by name: what `cablejax.train.fit` runs for a batch, and a forward pass."""
    import jax
    import jax.numpy as jnp
    from flax import nnx

    from cablejax.nets import build_model
    from cablejax.train import TrainConfig
    from cablejax.train.batches import make_plan
    from cablejax.train.engine import Engine

    arrays = tuple(map(jnp.asarray, data))
    xyz, mask, label = arrays[:3]
    model = build_model(name, CLASSES, rngs=nnx.Rngs(0), **options)
    config = TrainConfig(batch_size=len(label), steps_per_dispatch=1)
    engine = Engine(model, config, make_plan(len(label), config, model))
    state, rows = engine.initial_state(), jnp.arange(len(label))[None]
    run = engine._compiled(state, arrays, rows)
    model.eval()
    graphdef, weights = nnx.split(model)
    forward = jax.jit(lambda weights, xyz, mask: nnx.merge(graphdef, weights, copy=True)(xyz, mask))

    def step() -> float:
        nonlocal state
        state, report = run(state, arrays, rows, engine.schedule)
        return float(report.loss[0])

    return step, lambda: jax.block_until_ready(forward(weights, xyz, mask))


def peer(name: str, data: tuple[np.ndarray, ...], k: int) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """`(step, infer)` of PyTorch, eager."""
    import torch

    from benchmarks import torch_nets

    torch.manual_seed(0)
    model = torch_nets.ADGCNN(CLASSES, k=k) if name == "adgcnn" else torch_nets.dgcnn(CLASSES, k=k)
    optimizer = torch.optim.Adadelta(model.parameters(), lr=1.0, rho=0.95, eps=1e-6)
    posed = [torch.from_numpy(each) for each in pose(data[0])]
    label = torch.from_numpy(data[2]).long()

    def step() -> float:
        model.train()
        optimizer.zero_grad()
        loss = torch.nn.functional.cross_entropy(model(*posed), label)
        loss.backward()
        optimizer.step()
        return float(loss.detach())

    def infer() -> Any:
        model.eval()
        with torch.inference_mode():
            return model(*posed)

    return step, infer


def pose(xyz: np.ndarray) -> tuple[np.ndarray, ...]:
    """Posed clouds by NumPy, for the peer: these half-cylinders lie along x already."""
    radius = np.linalg.norm(xyz[..., 1:], axis=2) / 20.0
    features = np.concatenate([xyz / 20.0, radius[..., None]], axis=2)
    return features, xyz[..., 0] / 20.0, np.arctan2(xyz[..., 2], xyz[..., 1]), radius


def first(name: str, clouds: int, points: int, k: int, start: float) -> None:
    """Take one step and print the seconds since `start`."""
    ours(name, batch(clouds, points), k)[0]()
    print(time.perf_counter() - start)


def first_step(options: argparse.Namespace) -> dict[str, float]:
    """Seconds from an empty process to the first step done: `(cold, warm)`."""
    code = FIRST_STEP.format(options.model, options.clouds, options.points, options.k)
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        cache = {"JAX_COMPILATION_CACHE_DIR": folder, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
        environment = os.environ | cache | {"JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1"}
        for kind in ("cold", "warm"):
            done = subprocess.run(
                [sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True
            )
            seconds[f"first_step_{kind}_s"] = float(done.stdout.split()[-1])
    return seconds


def peak_gb(options: argparse.Namespace, side: str) -> float:
    """Peak resident memory of a process that takes three steps of one side, GB, that of its imports included."""
    command = [sys.executable, "-m", "benchmarks.train_step", "--memory", side, "--model", options.model]
    sizes = ["--clouds", str(options.clouds), "--points", str(options.points), "--k", str(options.k)]
    done = subprocess.run([*command, *sizes], check=True, capture_output=True, text=True)
    return float(done.stdout.split()[-1])


def main() -> None:
    """Time both sides in turn, print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", choices=["adgcnn", "dgcnn"], default="adgcnn")
    parser.add_argument("--clouds", type=int, default=16)
    parser.add_argument("--points", type=int, default=1024)
    parser.add_argument("--k", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--memory", choices=["cablejax", "torch"], help="one side alone; print its peak memory in GB")
    parser.add_argument("--first-step", action="store_true", help="time to the first step, cold and warm")
    parser.add_argument("--peaks", action="store_true", help="peak memory of both sides")
    parser.add_argument("--write", action="store_true", help=f"write to {RESULT}; leave it out on a busy machine")
    options = parser.parse_args()
    data = batch(options.clouds, options.points)
    sides = {"cablejax": ours, "torch": peer}
    if options.memory:
        step, _ = sides[options.memory](options.model, data, options.k)
        losses = [step() for _ in range(3)]
        assert np.isfinite(losses).all()
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6)
        return
    config = {key: value for key, value in vars(options).items() if key != "memory"}
    if options.first_step:
        config |= first_step(options)
    if options.peaks:
        config |= {f"peak_gb_{side}": peak_gb(options, side) for side in sides}
    built = {name: make(options.model, data, options.k) for name, make in sides.items()}
    for index, kind in enumerate(("step", "inference")):
        runs = {name: both[index] for name, both in built.items()}
        seconds = {}
        for name, run in runs.items():
            start = time.perf_counter()
            run()
            seconds[name] = time.perf_counter() - start
        title = f"train_{options.model}_{kind}"
        alternate(title, runs, seconds, config, RESULT / f"{title}.json" if options.write else None)


if __name__ == "__main__":
    main()
