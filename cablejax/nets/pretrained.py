"""Networks that come with the package: weights with a digest, and a card that says what they can be relied on for.

A network is two files in `cablejax/nets/weights`: `<name>.npz`, an archive of plain arrays by their dotted names, and
`<name>.json`, its card with the SHA-256 of the archive. Nothing in them is code, and nothing is unpickled.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.models import build_model
from cablejax.nets.part_network import PartNetwork

FOLDER = files("cablejax.nets") / "weights"
LICENCE = "Apache-2.0"
# What a card must hold; what else it holds is for reading.
CARD = ("name", "about", "model", "options", "classes", "clouds", "accuracy", "limits", "command", "licence", "sha256")
UNREADABLE = (KeyError, ValueError, EOFError, OSError, RuntimeError, zipfile.BadZipFile, zlib.error)


class WeightsError(ValueError):
    """A network that does not come with the package, or whose files are damaged; the message is one sentence."""


class Pretrained(NamedTuple):
    """A trained network.

    Attributes:
        network: In evaluation mode; called as `(xyz [b, n, 3] mm, mask [b, n]) -> logits`. With a `temperature` on the card it
            is `Calibrated`, whose `network` is the one that was trained.
        card: What it is: `about`, `classes` (names in the order of the logits), `clouds` (settings of the clouds it was
            trained on), `accuracy` (with its interval), `limits`, `command`, `licence`.
    """

    network: nnx.Module
    card: dict[str, Any]


class Calibrated(nnx.Module):
    """A network whose logits are divided by one temperature, so that it is right as often as it is sure (Guo et al. 2017).

    Args:
        network: Called as `(xyz, mask) -> logits`.
        temperature: Above 1 makes it more modest, below 1 less.
    """

    def __init__(self, network: nnx.Module, temperature: float):
        if not temperature > 0:
            raise ValueError(f"temperature: expected a number above 0, got {temperature!r}")
        self.network = network
        self.temperature = temperature

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Calibrated logits; the likeliest class stays."""
        return self.network(xyz, mask) / self.temperature  # pyright: ignore[reportCallIssue] any that is called so


def pretrained_names(folder: Traversable = FOLDER) -> list[str]:
    """Names that `load_pretrained` takes."""
    return sorted(each.name.removesuffix(".json") for each in folder.iterdir() if each.name.endswith(".json"))


def load_pretrained(name: str, *, folder: Traversable = FOLDER) -> Pretrained:
    """A network that comes with the package, with its card.

    Args:
        name: One of `pretrained_names()`.
        folder: Where the files lie.

    Raises:
        WeightsError: If there is no such network, or its files are damaged.

    Example:
        >>> found = load_pretrained("adgcnn_fit")
        >>> found.card["classes"][:3], found.network(jnp.ones((1, 512, 3)), jnp.ones((1, 512), bool)).shape
        (['25', '35', '50'], (1, 13))
    """
    card = read_card(name, folder=folder)
    path = folder / f"{name}.npz"
    try:
        data = path.read_bytes()
    except OSError as error:
        raise WeightsError(f"{path}: the weights cannot be read ({error.strerror})") from None
    if hashlib.sha256(data).hexdigest() != card["sha256"]:
        raise WeightsError(
            f"{path}: the weights are damaged (their SHA-256 is not that of the card); install the package anew"
        )
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
    except UNREADABLE as error:
        raise WeightsError(f"{path}: the weights are no archive of arrays ({error})") from None
    # Shapes alone: drawing weights that are thrown away would compile a program for each layer. In evaluation mode a network
    # has nothing beside the weights that are filled in.
    network = nnx.eval_shape(lambda: network_of(card))
    return Pretrained(calibrated(filled(network, arrays, source=str(path)), card), card)


def read_card(name: str, *, folder: Traversable = FOLDER) -> dict[str, Any]:
    """The card of a network, without its weights.

    Raises:
        WeightsError: If there is no such network, or the card is damaged.
    """
    names = pretrained_names(folder)
    if name not in names:
        raise WeightsError(f"name: expected one of {', '.join(names)}, got {name!r}")
    path = folder / f"{name}.json"
    try:
        card = json.loads(path.read_bytes())
    except (OSError, ValueError):
        raise WeightsError(f"{path}: the card is damaged; install the package anew") from None
    missing = [key for key in CARD if not isinstance(card, dict) or key not in card]
    if missing:
        raise WeightsError(f"{path}: the card is damaged, it lacks {', '.join(missing)}; install the package anew")
    return card


def network_of(card: Mapping[str, Any]) -> nnx.Module:
    """The network that a card describes, with fresh weights, in evaluation mode."""
    classes, options = len(card["classes"]), dict(card["options"])
    rngs = nnx.Rngs(0)
    if card["model"] == "parts":
        network: nnx.Module = PartNetwork(classes, rngs=rngs, **options)
    else:
        network = build_model(card["model"], classes, rngs=rngs, **options)
    network.eval()
    return network


def calibrated(network: nnx.Module, card: Mapping[str, Any]) -> nnx.Module:
    """The network at the temperature of its card, as it is where there is none."""
    return Calibrated(network, card["temperature"]) if "temperature" in card else network


def arrays_of(network: nnx.Module) -> dict[str, np.ndarray]:
    """Parameters and running statistics by their dotted names; kernels in half precision, the rest in single."""
    state = nnx.state(network, nnx.Any(nnx.Param, nnx.BatchStat))
    return {
        _dotted(path): np.asarray(leaf, np.float16 if np.ndim(leaf) > 1 else np.float32)
        for path, leaf in jax.tree.leaves_with_path(state)
    }


def filled(network: nnx.Module, arrays: Mapping[str, np.ndarray], *, source: str) -> nnx.Module:
    """The network with the arrays as its weights, all of them and nothing besides.

    Raises:
        WeightsError: If a name or a shape differs.
    """
    graphdef, state, rest = nnx.split(network, nnx.Any(nnx.Param, nnx.BatchStat), ...)
    wanted = {_dotted(path): leaf.shape for path, leaf in jax.tree.leaves_with_path(state)}
    differing = sorted({*wanted} ^ {*arrays}) or [key for key, shape in wanted.items() if arrays[key].shape != shape]
    if differing:
        raise WeightsError(f"{source}: the weights do not fit the network, {differing[0]} differs")
    # Cast by NumPy: on the device, a program for each shape.
    state = jax.tree.map_with_path(lambda path, leaf: jnp.asarray(arrays[_dotted(path)].astype(leaf.dtype)), state)
    return nnx.merge(graphdef, state, rest, copy=True)


def _dotted(path: Any) -> str:
    """A leaf's path as `layers.0.kernel`."""
    keys = (str(getattr(key, "key", getattr(key, "name", key))) for key in path)
    return ".".join(keys).removesuffix(".value")
