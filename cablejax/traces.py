"""Programs that are traced once on a machine, and not in each process that runs them.

Tracing and lowering a filter takes 5 to 8 s in each process, reading what another process has kept 0.5 s. What is kept is
the portable form of `jax.export`, beside the compiled programs, and gives the same numbers bit for bit.
"""

import functools
import hashlib
import importlib.util
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from jax import export

import cablejax
from cablejax.compiled import ProgramStore, trace_store
from cablejax.programs import make_room

_ALL: "weakref.WeakSet[Traced]" = weakref.WeakSet()


class Traced:
    """A jitted function of arrays whose trace is kept, where jax keeps compiled programs and flatbuffers is installed.

    Args:
        function: Under `jax.jit`, with static arguments by keyword. What it takes may be any tree of arrays; NamedTuples
            that it gives must be known to `jax.export` (`register_namedtuple_serialization`).
    """

    def __init__(self, function: Any):
        functools.update_wrapper(self, function)
        self._function: Any = function
        self._programs: dict[str, Callable[..., Any]] = {}
        _ALL.add(self)

    def __call__(self, *arrays: Any, **static: Any) -> Any:
        """The function's result."""
        store = _store()
        if store is None:
            return self._function(*arrays, **static)
        leaves, tree = jax.tree.flatten(arrays)
        return self._program(store, leaves, tree, static)(*leaves)

    def load(self, *arrays: Any, **static: Any) -> None:
        """Have the program for such arguments ready, read or compiled and not run."""
        store = _store()
        if store is not None:
            self._program(store, *jax.tree.flatten(arrays), static)

    def _program(self, store: ProgramStore, leaves: Any, tree: Any, static: dict[str, Any]) -> Callable[..., Any]:
        key = self._key(leaves, tree, static)
        if key not in self._programs:
            if make_room():  # what is held here is none of the caches that it empties
                for each in _ALL:
                    each._programs.clear()
            called = self._exported(store, key, leaves, tree, static).call
            self._programs[key] = jax.jit(called).lower(*leaves).compile()
        return self._programs[key]

    def _key(self, leaves: Any, tree: Any, static: dict[str, Any]) -> str:
        """What a trace depends on: the sources, jax, the kind of device, the arguments' shapes and the static ones."""
        shapes = [(str(jax.typeof(leaf)), getattr(jax.typeof(leaf), "weak_type", False)) for leaf in leaves]
        name = f"{self._function.__module__}.{self._function.__name__}"
        about = (name, _sources(), jax.__version__, jax.default_backend(), str(tree), shapes, sorted(static.items()))
        return f"trace {about}"

    def _exported(
        self, store: ProgramStore, key: str, leaves: Any, tree: Any, static: dict[str, Any]
    ) -> export.Exported:
        kept = store.get(key)
        if kept is None:

            def flat(*leaves: Any) -> Any:
                return self._function(*jax.tree.unflatten(tree, leaves), **static)

            kept = bytes(export.export(jax.jit(flat))(*leaves).serialize())
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
