"""A task and what came of it, in a form that can be sent to another process."""

import importlib
import os
from typing import Any, Literal, NamedTuple


class Task(NamedTuple):
    """A function to call.

    Attributes:
        name: Of the task, unique among those that run together.
        function: Where it is: "package.module:function".
        arguments: By keyword; JSON-ready.
        folder: Where relative paths among them begin.
        time_limit_s: After which a process of its own is killed; no limit if None, or without such a process.
    """

    name: str
    function: str
    arguments: dict[str, Any]
    folder: str
    time_limit_s: float | None = None


class Outcome(NamedTuple):
    """What came of a task.

    Attributes:
        name: Of the task.
        kind: "returned"; "raised", for an exception; "crashed", where its process died each time, or
            took too long.
        value: What the function returned, JSON-ready; None otherwise.
        reason: The exception or the death in words; empty where it returned.
        attempts: How often it was begun.
    """

    name: str
    kind: Literal["returned", "raised", "crashed"]
    value: Any = None
    reason: str = ""
    attempts: int = 1


def call(task: Task) -> Outcome:
    """Call a task's function in this process."""
    module, name = task.function.split(":")
    try:
        os.chdir(task.folder)
        return Outcome(task.name, "returned", getattr(importlib.import_module(module), name)(**task.arguments))
    except Exception as error:  # noqa: BLE001 (whatever it is, it must not cost the other tasks)
        return Outcome(task.name, "raised", reason=f"{type(error).__name__}: {error}")
