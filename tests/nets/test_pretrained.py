"""Networks of the package: each gives what its card says, and a damaged or unknown one is refused in a sentence."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from flax import nnx

from cablejax.nets import WeightsError, build_model, load_pretrained, pretrained_names
from cablejax.nets.pretrained import CARD, FOLDER, arrays_of, filled

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
MOST_BYTES = 8_000_000  # of all together, in the wheel


@pytest.mark.parametrize("name", pretrained_names())
def test_a_network_says_what_it_said_when_it_was_stored(name):
    network, card = load_pretrained(name)
    with np.load(GOLDEN / f"pretrained_{name}.npz", allow_pickle=False) as sample:
        xyz, mask, label, stored = (sample[key] for key in ("xyz", "mask", "label", "logits"))
    logits = np.asarray(jax.jit(network)(xyz, mask))
    chance, expected = (np.asarray(jax.nn.softmax(each)) for each in (logits, stored))
    # Another processor's sums may swap neighbours that are equally far, which changes a few points' features.
    assert np.quantile(np.abs(chance - expected)[mask] if label.ndim > 1 else np.abs(chance - expected), 0.95) < 0.02
    right = (chance.argmax(axis=-1) == label)[mask] if label.ndim > 1 else chance.argmax(axis=-1) == label
    clouds = len(label)
    # The card's accuracy is that of all test clouds; three standard deviations of a sample of so many.
    room = 3 * np.sqrt(card["accuracy"]["test"] * (1 - card["accuracy"]["test"]) / clouds)
    assert right.mean() > card["accuracy"]["test"] - room
    assert len(card["classes"]) == stored.shape[-1]


def test_what_the_cards_say():
    assert "adgcnn_fit" in pretrained_names()
    for name in pretrained_names():
        card = load_pretrained(name).card
        assert card["name"] == name
        assert card["licence"] == "Apache-2.0"
        assert card["command"].startswith("python -m experiments.")
        assert card["limits"].endswith(".")
        assert 0 < card["accuracy"]["test"] <= 1
    assert sum(len(each.read_bytes()) for each in FOLDER.iterdir() if each.is_file()) < MOST_BYTES


def test_an_unknown_name_is_refused():
    with pytest.raises(WeightsError, match=r"name: expected one of .*adgcnn_fit.*, got 'resnet'"):
        load_pretrained("resnet")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of one network."""
    for name in ("adgcnn_fit.npz", "adgcnn_fit.json"):
        (tmp_path / name).write_bytes((FOLDER / name).read_bytes())
    return tmp_path


def _card_without(folder: Path, key: str) -> None:
    card = json.loads((folder / "adgcnn_fit.json").read_bytes())
    (folder / "adgcnn_fit.json").write_text(json.dumps({name: value for name, value in card.items() if name != key}))


DAMAGE = {
    "a byte flipped": lambda at: _flip(at / "adgcnn_fit.npz"),
    "weights cut": lambda at: (at / "adgcnn_fit.npz").write_bytes((at / "adgcnn_fit.npz").read_bytes()[:1000]),
    "weights empty": lambda at: (at / "adgcnn_fit.npz").write_bytes(b""),
    "weights gone": lambda at: (at / "adgcnn_fit.npz").unlink(),
    "card empty": lambda at: (at / "adgcnn_fit.json").write_bytes(b""),
    "card no object": lambda at: (at / "adgcnn_fit.json").write_text("[]"),
    **{f"card without {key}": lambda at, key=key: _card_without(at, key) for key in CARD},
}


def _flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_files_are_refused_in_a_sentence(folder, damage):
    DAMAGE[damage](folder)
    with pytest.raises(WeightsError, match=r"adgcnn_fit\.(npz|json): the (weights|card)") as told:
        load_pretrained("adgcnn_fit", folder=folder)
    assert "\n" not in str(told.value)


def test_weights_of_another_network_are_refused():
    options = {"k": 4, "widths": (8, 8), "enhancement": False, "fusion": False}
    small, large = (build_model("adgcnn", 3, rngs=nnx.Rngs(0), shared_width=w, **options) for w in (8, 16))
    arrays = arrays_of(small)
    with pytest.raises(WeightsError, match=r"here: the weights do not fit the network, .* differs"):
        filled(large, arrays, source="here")
    del arrays["shared.kernel"]
    with pytest.raises(WeightsError, match=r"shared\.kernel differs"):
        filled(small, arrays, source="here")
