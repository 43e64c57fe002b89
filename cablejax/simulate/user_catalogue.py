"""A user's own cables, from a YAML file."""

import math
from pathlib import Path
from typing import Any

from cablejax.simulate.nominal import Cable

NUMBERS = ("size_mm2", "diameter_mm", "conductor_mm", "insulation_mm", "sheath_mm")
TEXTS = ("name", "voltage_kv", "source")
REQUIRED = ("name", "size_mm2", "diameter_mm", "source")


def read_catalogue(path: str | Path) -> tuple[Cable, ...]:
    """Read cables from YAML: a list of mappings with the fields of `Cable`, smallest diameter first in the result.

    `name`, `size_mm2`, `diameter_mm` and `source` are required; other dimensions that are left out become NaN, since
    nothing but the outer diameter decides how a cable looks to a scanner.

    Raises:
        ValueError: If the file is no such list, naming the file, the entry and the field.
        OSError: If the file cannot be read.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "own.yaml"
        >>> _ = file.write_text("- {name: ours 240, size_mm2: 240, diameter_mm: 35.1, source: data sheet 7}")
        >>> read_catalogue(file)[0].diameter_mm
        35.1
    """
    import yaml

    try:
        entries = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: expected YAML, got {str(error).splitlines()[0]}") from None
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"{path}: expected a list of cables, got {type(entries).__name__}")
    cables = [_cable(entry, f"{path}: cable {number}") for number, entry in enumerate(entries, 1)]
    names = [cable.name for cable in cables]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(f"{path}: expected different names, got {repeated[0]!r} more than once")
    return tuple(sorted(cables, key=lambda cable: cable.diameter_mm))


def _cable(entry: Any, where: str) -> Cable:
    if not isinstance(entry, dict):
        raise ValueError(f"{where}: expected a mapping, got {type(entry).__name__}")
    unknown = sorted(str(key) for key in entry if key not in NUMBERS + TEXTS)
    if unknown:
        raise ValueError(f"{where}: expected the fields {', '.join(TEXTS + NUMBERS)}, got {unknown[0]!r}")
    missing = [key for key in REQUIRED if key not in entry]
    if missing:
        raise ValueError(f"{where}: expected {missing[0]!r}, got only {', '.join(entry)}")
    numbers = (_number(entry[key], f"{where}, {key}") if key in entry else math.nan for key in NUMBERS)
    size, diameter, conductor, insulation, sheath = numbers
    name, voltage, source = (str(entry.get(key, "")) for key in TEXTS)
    return Cable(
        name=name,
        size_mm2=size,
        voltage_kv=voltage,
        diameter_mm=diameter,
        conductor_mm=conductor,
        insulation_mm=insulation,
        sheath_mm=sheath,
        source=source,
    )


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not (math.isfinite(value) and value > 0):
        raise ValueError(f"{where}: expected a number above 0, got {value!r}")
    return float(value)
