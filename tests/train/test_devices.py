"""Eight devices, two processes: the losses of one device."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HEAD = """
import json, sys
import jax
from flax import nnx
from tests.train.tiny import *
from cablejax.train import fit
# Not Adam: it divides rounding by its own size where a gradient is zero (a bias before batch normalisation).
config = settings(optimizer="mbgd", learning_rate=0.1, epochs=3, batch_size=8)
def losses(folder=None, **options):
    result = fit(Tiny(nnx.Rngs(0), dropout=0.0), split(), split(seed=1), config, folder=folder, progress=False, **options)
    return [[e.train_loss, e.grad_norm, e.validation_loss] for e in result.history]
"""
DEVICES = """
assert jax.device_count() == 8
from cablejax.nets.aedgeconv import AEdgeConv
class Edges(nnx.Module):
    def __init__(self, rngs):
        self.layer, self.out = AEdgeConv(3, 8, k=4, rngs=rngs), nnx.Linear(8, 3, rngs=rngs)
    def __call__(self, xyz, mask):
        return self.out(self.layer(xyz, mask).mean(axis=1))
one = jax.devices()[:1]
short = settings(optimizer="mbgd", epochs=2)
edges = [fit(Edges(nnx.Rngs(0)), split(), None, short, progress=False, devices=d) for d in (None, one)]
try:
    fit(Tiny(nnx.Rngs(0)), split(), None, settings(batch_size=6), progress=False)
except ValueError as error:
    refused = str(error)
print(json.dumps({
    "many": losses(), "one": losses(devices=one), "refused": refused,
    "edges": [[e.train_loss for e in each.history] for each in edges],
}))
"""
PROCESS = """
import time
from cablejax.train.resume import RunFolder
address, index, folder = sys.argv[1:]
jax.distributed.initialize(address, 2, int(index))
assert jax.device_count() == 2 and jax.local_device_count() == 1
save = RunFolder.save
RunFolder.save = lambda *given: (time.sleep(0.7), save(*given))  # the other one asks for the checkpoint before it is there
first = losses(folder)
print(json.dumps({"losses": first, "resumed": losses(folder)}))
"""


def start(code, *arguments, devices=1):
    environment = os.environ | {
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}",
        "JAX_PLATFORMS": "cpu",
    }
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def answer(process):
    try:
        out, errors = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 0, errors[-3000:]
    return json.loads(out.splitlines()[-1])


@pytest.fixture(scope="module")
def found():
    return answer(start(HEAD + DEVICES, devices=8))


def close(a, b):
    # Sums over the clouds of a batch are taken in parts: the last bits of float32, a few updates on.
    for x, y in zip(a, b, strict=True):
        assert x == pytest.approx(y, rel=1e-4)


def test_eight_devices_give_the_losses_of_one(found):
    close(found["many"], found["one"])


def test_edge_convolutions_are_cut_over_devices_as_well(found):
    close([found["edges"][0]], [found["edges"][1]])


def test_a_batch_that_cannot_be_cut_is_refused(found):
    assert found["refused"].startswith("batch_size: expected a multiple of the 8 devices, got 6")


def test_two_processes_give_the_losses_of_one_and_one_of_them_writes(found, tmp_path):
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        address = f"localhost:{probe.getsockname()[1]}"
    processes = [start(HEAD + PROCESS, address, str(index), str(tmp_path)) for index in range(2)]
    answers = [answer(process) for process in processes]
    for each in answers:
        close(each["losses"], found["one"])
        assert each["resumed"] == each["losses"]
    assert len(list((tmp_path / "checkpoints").glob("*.ckpt"))) == 2
