"""Stored splits: the same bytes back, damage noticed, a failed write harmless; and arrays of other makers."""

import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import DatasetConfig, Split, load_arrays, load_split, save_split

CONFIG = DatasetConfig(sizes_mm2=(25, 240), n_points=16, clouds_per_class=1)


@pytest.fixture
def split():
    xyz = jnp.arange(2 * 16 * 3, dtype=jnp.float32).reshape(2, 16, 3)
    return Split(xyz, jnp.ones((2, 16), bool), jnp.array([0, 1], jnp.int32), jnp.array([21.3, 34.2], jnp.float32))


@pytest.mark.parametrize("points", ["known", "not known"])
def test_round_trip(tmp_path, split, points):
    file = tmp_path / "train.npz"
    if points == "known":
        split = split._replace(on_cable=jnp.arange(32).reshape(2, 16) % 3 == 0)
    checksum = save_split(file, split, config=CONFIG, name="train")
    again, config, name = load_split(file)
    assert (again.on_cable is None) == (split.on_cable is None)
    pairs = [(a, b) for a, b in zip(split, again, strict=True) if a is not None]
    assert all(np.array_equal(a, b) and a.dtype == b.dtype for a, b in pairs)
    assert (config, name, len(checksum)) == (CONFIG, "train", 64)
    assert [p.name for p in tmp_path.iterdir()] == ["train.npz"]


def test_numpy_alone_reads_it(tmp_path, split):
    file = tmp_path / "train.npz"
    save_split(file, split, config=CONFIG, name="train")
    with np.load(file, allow_pickle=False) as arrays:
        assert sorted(arrays.files) == ["config", "diameter_mm", "label", "mask", "sha256", "xyz"]
        assert arrays["xyz"].dtype == np.float32


def test_damage_is_noticed_wherever_it_is(tmp_path, split):
    file = tmp_path / "train.npz"
    save_split(file, split, config=CONFIG, name="train")
    good = file.read_bytes()
    rng = np.random.default_rng(0)
    unnoticed = 0
    for place in rng.integers(0, len(good), 60):
        bad = bytearray(good)
        bad[place] ^= 0xFF
        file.write_bytes(bytes(bad))
        try:
            again, config, _ = load_split(file)
        except ValueError as error:
            assert str(file) in str(error)  # noqa: PT017
        else:  # bytes that mean nothing, such as a date in the archive
            unnoticed += 1
            assert config == CONFIG
            assert all(np.array_equal(a, b) for a, b in zip(split, again, strict=True))
    assert unnoticed < 20
    for cut in (0, 10, len(good) // 2, len(good) - 5):
        file.write_bytes(good[:cut])
        with pytest.raises(ValueError, match=r"train\.npz: "):
            load_split(file)


def test_a_failed_write_leaves_the_old_file(tmp_path, split, monkeypatch):
    file = tmp_path / "train.npz"
    save_split(file, split, config=CONFIG, name="train")
    old = file.read_bytes()

    def fail(target, **_):
        target.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OSError, match="disk full"):
        save_split(file, split, config=CONFIG, name="test")
    assert file.read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == ["train.npz"]


def test_name_must_end_in_npz(tmp_path, split):
    with pytest.raises(ValueError, match=r"path: expected a name that ends in \.npz"):
        save_split(tmp_path / "train.dat", split, config=CONFIG, name="train")


def write_arrays(path, **changes):
    rng = np.random.default_rng(1)
    arrays = {"xyz": rng.normal(50, 9, (40, 32, 3)).astype(np.float32), "label": np.arange(40) % 4,
              "classes": np.array(["a", "b", "c", "d"])}  # fmt: skip
    np.savez(path, **{**arrays, **changes})
    return path


def test_arrays_are_divided_by_class_and_centred(tmp_path):
    file = write_arrays(tmp_path / "clouds.npz")
    train, validation, names = load_arrays(file, n_points=20, validation_share=0.2)
    assert names == ("a", "b", "c", "d")
    assert np.bincount(train.label).tolist() == [8] * 4
    assert np.bincount(validation.label).tolist() == [2] * 4
    assert train.xyz.shape == (32, 20, 3)
    assert float(jnp.abs(train.xyz.mean(axis=1)).max()) < 1e-4
    assert float(train.xyz.std()) == pytest.approx(9.0, rel=0.1)
    both = np.concatenate([train.xyz, validation.xyz]).reshape(-1, 3)
    assert len(np.unique(both, axis=0)) == len(both)
    assert np.isnan(train.diameter_mm).all()
    again = load_arrays(file, n_points=20, validation_share=0.2)[0]
    assert again.xyz.tobytes() == train.xyz.tobytes()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"label": np.zeros(7, int)}, r"got \[40, 32, 3\], \[7\], \[4\]"),
        ({"label": np.full(40, 4)}, "expected labels 0 to 3, got 4 to 4"),
        ({"xyz": np.full((40, 32, 3), np.nan, np.float32)}, "expected finite coordinates"),
    ],
)
def test_arrays_refused(tmp_path, changes, words):
    with pytest.raises(ValueError, match=words):
        load_arrays(write_arrays(tmp_path / "clouds.npz", **changes), n_points=20)


def test_modelnet10(data_dir):
    file = data_dir / "classification" / "modelnet10_train_1024.npz"
    train, validation, names = load_arrays(file, n_points=64)
    assert len(train.label) + len(validation.label) == 3991
    assert names[:3] == ("bathtub", "bed", "chair")
    with np.load(file) as arrays:  # each cloud carries its model's name, "night_stand_0007"
        stems = np.array([name.rsplit("_", 1)[0] for name in arrays["name"]])
        assert (stems == arrays["classes"][arrays["label"]]).all()
