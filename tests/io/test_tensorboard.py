"""TensorBoard logs, read back from the event files."""

import os
import struct
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.io import RunLogger
from cablejax.io.tensorboard import confusion_image


def events(folder):
    """Every event of a folder: records of length, checksum, bytes, checksum."""
    from tensorboardX.proto.event_pb2 import Event

    found = []
    for path in sorted(folder.glob("events*")):
        content = path.read_bytes()
        while content:
            (length,) = struct.unpack("<Q", content[:8])
            found.append(Event.FromString(content[12 : 12 + length]))
            content = content[16 + length :]
    return found


def values(folder, tag):
    return [(event.step, value) for event in events(folder) for value in event.summary.value if value.tag == tag]


def test_scalars_come_back(tmp_path):
    with RunLogger(tmp_path) as log:
        log.scalar("loss", jnp.float32(0.5), 1)
        log.scalars({"loss": 0.25, "rate": np.float32(2.0)}, step=2)
    assert [(step, value.simple_value) for step, value in values(tmp_path, "loss")] == [(1, 0.5), (2, 0.25)]
    assert [(step, value.simple_value) for step, value in values(tmp_path, "rate")] == [(2, 2.0)]


def test_two_logs_of_one_second_do_not_overwrite_each_other(tmp_path):
    for step in (1, 2):
        with RunLogger(tmp_path) as log:
            log.scalar("loss", 0.5, step)
    assert sorted(step for step, _ in values(tmp_path, "loss")) == [1, 2]


def test_closed_on_an_error_with_all_that_was_logged(tmp_path):
    log = RunLogger(tmp_path)
    log.scalar("loss", 0.5, 1)
    with pytest.raises(KeyError), log:
        raise KeyError
    assert len(values(tmp_path, "loss")) == 1
    log.close()
    with pytest.raises(ValueError, match="log: expected an open one, got the closed log"):
        log.scalar("loss", 0.5, 2)


def test_a_resumed_run_purges_later_steps(tmp_path):
    with RunLogger(tmp_path, purge_step=7):
        pass
    assert [event.step for event in events(tmp_path) if event.HasField("session_log")] == [7]


def test_hparams_have_a_name(tmp_path):
    with RunLogger(tmp_path) as log:
        log.hparams({"rate": 1.0, "model": "adgcnn", "k": 20, "none": None}, {"accuracy": 0.9}, name="run")
    assert [value.simple_value for _, value in values(tmp_path / "run", "accuracy")] == [pytest.approx(0.9)]
    tags = {value.tag for event in events(tmp_path / "run") for value in event.summary.value}
    assert "_hparams_/session_start_info" in tags


def test_pictures_meshes_histograms(tmp_path):
    with RunLogger(tmp_path) as log:
        log.confusion("confusion", jnp.asarray([[3, 1], [0, 4]]), ["25", "35"], 1)
        log.mesh("cloud", np.zeros((5, 3)), 1, color=np.full((5, 3), 255))
        log.mesh("batch", np.zeros((3, 5, 3)), 1)
        log.histogram("attention", jnp.linspace(0, 1, 10), 1)
    assert [value.image.width for _, value in values(tmp_path, "confusion")] == [400]
    [(_, histogram)] = values(tmp_path, "attention")
    assert histogram.histo.num == 10
    meshes = [v.tag for e in events(tmp_path) for v in e.summary.value if v.metadata.plugin_data.plugin_name == "mesh"]
    assert len(meshes) == 3  # vertices and colours of the cloud, vertices of the batch


def test_confusion_counts_shade_the_right_cells():
    image = confusion_image(np.array([[4, 0], [4, 0]]), ["a", "b"])
    assert image.dtype == np.uint8
    dark = (image.sum(2) < 300).nonzero()
    # Both rows predict class a: the left column is filled, the right one is white but for labels.
    assert np.mean(dark[1] < image.shape[1] * 0.6) > 0.9
    with pytest.raises(ValueError, match="labels: expected 2"):
        confusion_image(np.eye(2), ["a"])


def test_works_without_a_display(tmp_path):
    code = """
import sys
import numpy as np
import cablejax
cablejax.ensure_right_sums()  # else jax 0.10.2 to 0.12 would be warned of
from cablejax.io import RunLogger
with RunLogger(sys.argv[1]) as log:
    log.confusion("c", np.eye(2), ["a", "b"], 0)
"""
    bare = {"PATH": os.environ["PATH"], "MPLBACKEND": "TkAgg"}  # no DISPLAY, and a backend that needs one
    subprocess.run([sys.executable, "-W", "error", "-c", code, str(tmp_path)], env=bare, check=True)
    assert len(values(tmp_path, "c")) == 1


def test_a_full_disk_is_an_error_and_not_a_hang(tmp_path):
    code = """
import resource, signal, sys
from cablejax.io import RunLogger
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
log = RunLogger(sys.argv[1])
try:
    for step in range(100_000):
        log.scalar("loss", 1.0, step)
except OSError as error:
    sys.exit(7)
"""
    assert (
        subprocess.run([sys.executable, "-c", code, str(tmp_path)], timeout=60, stderr=subprocess.DEVNULL).returncode
        == 7
    )
