"""No value that a run may bring ends its log: NaN, None, arrays, huge integers, histograms of nothing."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.io import RunLogger
from tests.io.test_tensorboard import values

WRITTEN = {
    "a number": (0.5, 0.5),
    "an integer": (3, 3.0),
    "a truth value": (True, 1.0),
    "NaN": (math.nan, math.nan),
    "infinity": (math.inf, math.inf),
    "beyond float32": (1e300, math.inf),
    "a NumPy scalar": (np.float32(0.5), 0.5),
    "float16": (np.float16(0.5), 0.5),
    "bfloat16": (jnp.bfloat16(0.5), 0.5),
    "an array of no rank": (np.array(0.5), 0.5),
    "an array of one element": (np.array([0.5]), 0.5),
    "one element, rank 3": (np.array([[[0.5]]]), 0.5),
    "a JAX array of one element": (jnp.array([0.5]), 0.5),
    "a list of one element": ([0.5], 0.5),
    "an integer beyond int64": (2**70, 2.0**70),
}
LEFT_OUT = {
    "None": None,
    "text": "0.5",
    "an array of two elements": np.array([0.5, 0.5]),
    "an empty array": np.array([]),
    "an integer beyond float64": 10**400,
    "a complex number": 1 + 2j,
    "a dictionary": {"a": 1},
    "an array of None": np.array([None]),
}


@pytest.mark.parametrize("kind", WRITTEN)
def test_metrics_that_are_written(tmp_path, kind):
    value, expected = WRITTEN[kind]
    with RunLogger(tmp_path) as log:
        log.scalar("metric", value, 1)
        log.hparams({"rate": 1.0}, {"final": value})
    for folder, tag in ((tmp_path, "metric"), (tmp_path / "hparams", "final")):
        [(_, found)] = values(folder, tag)
        assert found.simple_value == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("kind", LEFT_OUT)
def test_metrics_that_are_left_out_with_a_word(tmp_path, kind):
    with RunLogger(tmp_path) as log:
        with pytest.warns(UserWarning, match="metric is left out: expected one number"):
            log.scalars({"metric": LEFT_OUT[kind], "other": 1.0}, 1)
        with pytest.warns(UserWarning, match="final is left out: expected one number"):
            log.hparams({"rate": 1.0}, {"final": LEFT_OUT[kind], "other": 1.0})
    assert len(values(tmp_path, "other")) == len(values(tmp_path / "hparams", "other")) == 1
    assert values(tmp_path, "metric") == values(tmp_path / "hparams", "final") == []


@pytest.mark.parametrize("kind", [*WRITTEN, *LEFT_OUT])
def test_settings_are_numbers_or_text(tmp_path, kind):
    from tensorboardX.proto.plugin_hparams_pb2 import HParamsPluginData

    value = WRITTEN[kind][0] if kind in WRITTEN else LEFT_OUT[kind]
    with RunLogger(tmp_path) as log:
        log.hparams({"setting": value}, {"final": 1.0})
    [(_, entry)] = values(tmp_path / "hparams", "_hparams_/session_start_info")
    content = HParamsPluginData.FromString(entry.metadata.plugin_data.content)
    stored = content.session_start_info.hparams["setting"]
    if stored.WhichOneof("kind") == "number_value":
        assert math.isfinite(stored.number_value)  # JSON, which the plugin speaks, has no NaN
    else:
        assert stored.WhichOneof("kind") == ("bool_value" if value is True else "string_value")


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([], "none of its 0 values"),
        ([math.nan, math.inf], "none of its 2 values"),
        ([-1.7e308, 1.7e308], "left out: "),  # a range beyond float64
        ([1e16, 1e16 + 2], "left out: "),  # 64 bins in a range of one step
        ([1.0, math.nan], "1 of its 2 values are left out"),
    ],
)
def test_histograms_of_what_is_none(tmp_path, entries, words):
    with RunLogger(tmp_path) as log, pytest.warns(UserWarning, match=words):
        log.histogram("weights", np.array(entries), 1)
    assert len(values(tmp_path, "weights")) == (1 if 1.0 in entries else 0)


@pytest.mark.parametrize("entries", [[0.0], [2.0] * 5, [1e300, 1.0], [1e-320, 0.0], [True, False]])
def test_odd_histograms_are_written(tmp_path, entries):
    with RunLogger(tmp_path) as log:
        log.histogram("weights", np.array(entries), 1)
    assert len(values(tmp_path, "weights")) == 1


def test_pictures_and_clouds_of_nothing(tmp_path):
    with RunLogger(tmp_path) as log:
        for call, words in (
            (lambda: log.image("i", np.zeros((0, 4, 3)), 1), "cannot be drawn"),
            (lambda: log.image("i", np.zeros((4, 4, 2)), 1), "cannot be drawn"),
            (lambda: log.mesh("m", np.zeros((0, 3)), 1), "no points"),
            (lambda: log.confusion("c", np.zeros((0, 0)), [], 1), "no classes"),
        ):
            with pytest.warns(UserWarning, match=words):
                call()
        log.image("image", np.full((4, 4, 1), np.nan), 1)
        log.mesh("mesh", np.full((3, 3), np.nan), 1, color=np.full((3, 3), np.nan))
        log.confusion("confusion", np.array([[np.nan, 1], [0, 2]]), ["a", "b"], 1)
    assert len(values(tmp_path, "image")) == len(values(tmp_path, "confusion")) == 1
