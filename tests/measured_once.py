"""Measure each scan once in a process, for tests of what is made of a measurement: it takes seconds and says the same again."""

import functools
import hashlib
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from cablejax import measure
from cablejax.measure import cable

FOUND: dict[bytes, Any] = {}


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose results are kept by its arguments; what it raises is raised anew."""

    @functools.wraps(function)
    def kept(*args: Any, **kwargs: Any) -> Any:
        given = pickle.dumps((function.__qualname__, args, sorted(kwargs.items())))
        key = hashlib.sha256(given).digest()
        if key not in FOUND:
            FOUND[key] = function(*args, **kwargs)
        return FOUND[key]

    return kept


@pytest.fixture(autouse=True)
def _measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    single = once(measure.measure_cable)
    monkeypatch.setattr(measure, "measure_cable", single)
    monkeypatch.setattr(cable, "measure_cable", single)  # the same, where labels are asked after it
    monkeypatch.setattr(measure, "measure_cables", once(measure.measure_cables))
