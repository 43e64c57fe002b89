"""Programs that are traced once on a machine, and not in each process that runs them.

Tracing and lowering the kernels of a tile takes 7 s in each process, reading what another process has kept 0.5 s.
What is kept is the portable form of `jax.export`, beside the compiled programs, and gives the same numbers bit for bit.
"""

import functools
import hashlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from jax import export

import cablejax
from cablejax.compiled import ProgramStore, trace_store


class Traced:
    """A jitted function of arrays whose trace is kept, where jax keeps compiled programs and flatbuffers is installed.

    Args:
        function: Under `jax.jit`, with static arguments by keyword. NamedTuples that it takes or gives must be known to
            `jax.export` (`register_namedtuple_serialization`).
    """

    def __init__(self, function: Any):
        functools.update_wrapper(self, function)
        self._function: Any = function
        self._programs: dict[str, Callable[..., Any]] = {}

    def __call__(self, *arrays: Any, **static: Any) -> Any:
        """The function's result."""
        store = _store()
        if store is None:
            return self._function(*arrays, **static)
        return self._program(store, arrays, static)(*arrays)

    def load(self, *arrays: Any, **static: Any) -> None:
        """Have the program for such arguments ready, read or compiled and not run."""
        store = _store()
        if store is not None:
            self._program(store, arrays, static)

    def _program(self, store: ProgramStore, arrays: Any, static: dict[str, Any]) -> Callable[..., Any]:
        key = self._key(arrays, static)
        if key not in self._programs:
            self._programs[key] = jax.jit(self._exported(store, key, arrays, static).call).lower(*arrays).compile()
        return self._programs[key]

    def _key(self, arrays: Any, static: dict[str, Any]) -> str:
        """What a trace depends on: the sources, jax, the kind of device, the arguments' shapes and the static ones."""
        shapes = jax.tree.map(lambda array: (array.shape, str(array.dtype)), arrays)
        name = f"{self._function.__module__}.{self._function.__name__}"
        about = (name, _sources(), jax.__version__, jax.default_backend(), shapes, sorted(static.items()))
        return f"trace {about}"

    def _exported(self, store: ProgramStore, key: str, arrays: Any, static: dict[str, Any]) -> export.Exported:
        kept = store.get(key)
        if kept is None:
            kept = bytes(export.export(self._function)(*arrays, **static).serialize())
            store.put(key, kept)
        return export.deserialize(bytearray(kept))


def _store() -> ProgramStore | None:
    return trace_store() if importlib.util.find_spec("flatbuffers") is not None else None


@functools.cache
def _sources() -> str:
    """A digest of this package's code."""
    digest, root = hashlib.sha256(), Path(cablejax.__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return digest.hexdigest()
