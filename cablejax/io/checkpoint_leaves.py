"""The leaves of a checkpoint: how an array, a random key or a number becomes bytes and comes back, bit for bit."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

SCALARS = {"bool": bool, "int": int, "float": float, "str": str}
# A key's dtype prints the short tag of its generator.
SHORT_IMPLS = {"threefry2x32": "fry", "rbg": "rbg", "unsafe_rbg": "urbg"}


class Leaf(NamedTuple):
    """One leaf, ready to be written.

    Attributes:
        entry: Its line in the header: path, kind, and what the kind needs.
        data: Its bytes, little-endian, row-major; empty for what the header holds whole.
    """

    entry: dict[str, Any]
    data: bytes | memoryview


def encode_leaf(path: str, value: Any) -> Leaf:
    """Turn a leaf into a header entry and bytes.

    Raises:
        ValueError: If the leaf is of a kind that is not stored, or is spread over other processes.
    """
    if type(value).__name__ in SCALARS and type(value) is SCALARS[type(value).__name__]:
        text = value.hex() if isinstance(value, float) else value
        return Leaf({"path": path, "kind": type(value).__name__, "value": text, "bytes": 0}, b"")
    if not isinstance(value, jax.Array | np.ndarray | np.generic):
        raise ValueError(
            f"tree: leaf {path}: expected an array, number, string or random key, got {type(value).__name__}"
        )
    entry: dict[str, Any] = {"path": path, "kind": "array"}
    if isinstance(value, jax.Array):
        if not value.is_fully_addressable:
            raise ValueError(f"tree: leaf {path}: expected an array of this process, got one spread over several")
        if is_key(value):
            entry |= {"kind": "key", "impl": str(jax.random.key_impl(value))}
            value = jax.random.key_data(value)
    array = np.asarray(value)
    if array.dtype.hasobject:
        raise ValueError(f"tree: leaf {path}: expected numbers, got dtype {array.dtype}")
    array = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("<"))).reshape(array.shape)
    entry |= {"dtype": array.dtype.name, "shape": list(array.shape), "bytes": array.nbytes}
    return Leaf(entry, array.tobytes())


def same_kind(entry: dict[str, Any], template: Any) -> str | None:
    """Why a stored leaf does not fit a template leaf, None where it does."""
    if entry["kind"] in SCALARS or type(template).__name__ in SCALARS:
        wanted = type(template).__name__
        return None if wanted == entry["kind"] else f"is stored as {entry['kind']}, expected {wanted}"
    if (entry["kind"] == "key") != is_key(template):
        return f"is stored as {entry['kind']}, expected {'key' if is_key(template) else 'array'}"
    if entry["kind"] == "key":
        shape, dtype = entry["shape"][: len(template.shape)], str(template.dtype)
        stored_dtype = f"key<{SHORT_IMPLS.get(entry['impl'], entry['impl'])}>"
    else:
        shape, dtype, stored_dtype = entry["shape"], np.dtype(template.dtype).name, entry["dtype"]
    if list(template.shape) != shape or dtype != stored_dtype:
        return f"is stored as {stored_dtype}{shape}, expected {dtype}{list(template.shape)}"
    return None


def decode_leaf(entry: dict[str, Any], data: memoryview, template: Any) -> Any:
    """Turn a header entry and bytes into a leaf of the template's kind and sharding."""
    if entry["kind"] in SCALARS:
        return float.fromhex(entry["value"]) if entry["kind"] == "float" else SCALARS[entry["kind"]](entry["value"])
    dtype = np.dtype(jnp.dtype(entry["dtype"])).newbyteorder("<")
    array = np.frombuffer(data, dtype).reshape(entry["shape"])
    array = array.astype(array.dtype.newbyteorder("="))
    if isinstance(template, np.generic):
        return array[()]
    if isinstance(template, np.ndarray):
        return array
    if entry["kind"] == "key":
        return _place(jax.random.wrap_key_data(jnp.asarray(array), impl=entry["impl"]), template)
    # A weakly typed scalar stays one, or the first step after a restart would be compiled anew with other promotions.
    if getattr(template, "weak_type", False) and array.ndim == 0:
        return _place(jnp.asarray(array.item()), template)
    return _place(jnp.asarray(array), template)


def is_key(value: Any) -> bool:
    """Whether a leaf is an array of typed random keys."""
    return hasattr(value, "dtype") and jnp.issubdtype(value.dtype, jax.dtypes.prng_key)


def _place(value: jax.Array, template: Any) -> jax.Array:
    """Put an array where the template's lies; a shape without devices leaves it on the default one."""
    sharding = getattr(template, "sharding", None)
    return value if sharding is None else jax.device_put(value, sharding)
