"""What the native readers make of a scan: poses, spherical coordinates, colour limits, and how they fail."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from cablejax.io import child


class Node(dict):
    """A node of an E57 file's tree."""

    def isDefined(self, name):
        return name in self

    def value(self):
        return self["value"]


def header(largest=None, pose=False, turn=None, shift=(0, 0, 0)):
    limits = (
        {} if largest is None else {f"color{name}Maximum": Node(value=largest) for name in ("Red", "Green", "Blue")}
    )
    node = Node(colorLimits=Node(limits)) if limits else Node()
    return SimpleNamespace(
        node=node,
        has_pose=lambda: pose,
        rotation_matrix=np.eye(3) if turn is None else turn,
        translation=np.asarray(shift),
    )


def test_spherical_coordinates_become_cartesian():
    """Azimuth from x towards y, elevation from the horizontal plane, as ASTM E2807 defines them."""
    columns = {
        "sphericalRange": np.array([2.0, 2.0, 2.0, 9.0]),
        "sphericalAzimuth": np.array([0.0, np.pi / 2, 0.0, 0.0]),
        "sphericalElevation": np.array([0.0, 0.0, np.pi / 2, 0.0]),
        "sphericalInvalidState": np.array([0.0, 0.0, 0.0, 2.0]),
    }
    chunk = child._e57_chunk(columns, child.SPHERICAL, {"sphericalInvalidState"}, header())
    assert np.allclose(chunk["xyz"], [[2, 0, 0], [0, 2, 0], [0, 0, 2]], atol=1e-15)
    assert (chunk["dropped"], chunk["color"], chunk["intensity"]) == (1, None, None)


def test_pose_turns_first_and_then_shifts():
    columns = {name: np.array([value]) for name, value in zip(child.CARTESIAN, (1.0, 2.0, 3.0), strict=True)}
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    chunk = child._e57_chunk(columns, child.CARTESIAN, set(), header(pose=True, turn=quarter, shift=(10, 20, 30)))
    assert chunk["xyz"].tolist() == [[8, 21, 33]]


@pytest.mark.parametrize(
    ("largest", "values", "kind", "expected"),
    [
        (255, [255, 0, 7], np.uint8, [255, 0, 7]),
        (65535, [255, 0, 7], np.uint16, [255, 0, 7]),
        (1.0, [1.0, 0.0, 0.5], np.uint8, [255, 0, 128]),
        (None, [255, 0, 7], np.uint16, [255, 0, 7]),
    ],
)
def test_colors_follow_their_limits(largest, values, kind, expected):
    color, notes = child._e57_color(np.array([values], float), header(largest))
    assert notes == []
    assert color is not None
    assert color.dtype == kind
    assert color.tolist() == [expected]


@pytest.mark.parametrize("value", [256.0, -1.0, np.nan])
def test_colors_outside_their_limits_are_left_out(value):
    color, notes = child._e57_color(np.array([[value, 0, 0]]), header(255))
    assert color is None
    assert notes == ["its colours are left out: they hold numbers outside their limits of 0 to 255"]


class Panic(BaseException):
    """What a panic in Rust becomes."""


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "larger than this machine's memory"),
        (ImportError("no laspy", name="laspy"), r"package that is missing \(laspy\): pip install 'cablejax\[scan\]'"),
        (child.Damaged("is short"), "^is short$"),
        (Panic("index\n out of bounds"), r"damaged or truncated \(index out of bounds\)"),
        (RuntimeError(), r"damaged or truncated \(RuntimeError\)"),
    ],
)
def test_every_failure_is_sent_as_a_reason(tmp_path, monkeypatch, error, words):
    def fail(path, size):
        yield {"xyz": np.ones((1, 3)), "color": None, "intensity": None, "dropped": 0}
        raise error

    monkeypatch.setitem(child.CHUNKS, "las", fail)
    monkeypatch.setattr(child, "limit_memory", lambda memory_bytes: None)
    with (tmp_path / "out").open("wb") as out:
        child.main("las", "a.las", 0, 0, out)
    lines = (tmp_path / "out").read_bytes().split(b"\n")
    assert json.loads(lines[0])["arrays"] == {"xyz": ["<f8", [1, 3]]}
    assert re.search(words, json.loads(lines[1][24:])["error"])  # after three float64


def las_counts(tmp_path, ending, change):
    import laspy

    las = laspy.LasData(laspy.LasHeader(version="1.2", point_format=0))
    las.x = las.y = las.z = np.arange(100.0)
    path = tmp_path / f"a.{ending}"
    las.write(str(path))
    data = bytearray(path.read_bytes())
    data[107:111] = (100 + change).to_bytes(4, "little")
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(("change", "words"), [(-1, "100 points, more than the 99"), (2, "promises 102 points, 100")])
def test_a_wrong_count_in_a_las_header_is_noticed(tmp_path, change, words):
    path = las_counts(tmp_path, "las", change)
    with pytest.raises(child.Damaged, match=words):
        list(child.las_chunks(str(path)))


def test_a_las_header_that_counts_one_too_many_is_followed_by_a_note(tmp_path):
    chunks = list(child.las_chunks(str(las_counts(tmp_path, "las", 1)), 30))
    assert [len(chunk["xyz"]) for chunk in chunks] == [30, 30, 30, 10, 0]
    assert chunks[-1]["notes"] == ["its header promises 101 points, 100 are there and were read"]


def test_a_count_beyond_the_chunk_table_is_noticed(tmp_path):
    """LAZ compresses 50,000 points a chunk: a header that promises another chunk is wrong."""
    path = las_counts(tmp_path, "laz", 50_000)
    with pytest.raises(child.Damaged, match="promises 50,100 points, its chunks hold 50,000"):
        list(child.las_chunks(str(path)))
