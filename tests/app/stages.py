"""Stages of made-up work, for a desk without measurements: what to do is the file's content."""

import os
import time
from pathlib import Path
from typing import Any

CABLE = {"number": 1, "diameter_mm": 20.0, "interval_mm": [19.9, 20.1]}


def stage(stage: str, path: str, arguments: list[str], folder: str) -> dict[str, Any]:
    """Do what the file says for the stage, "every slow" say; without a word all goes well."""
    wishes = dict(line.split() for line in Path(path).read_text().splitlines())
    with Path(folder, "ran").open("a") as file:
        file.write(f"{stage} {' '.join(arguments)}\n")
    match wishes.get(stage):
        case "slow":
            time.sleep(60)
        case "no":
            return {"error": f"{path}: {stage} found nothing"}
        case "die":
            os.abort()
        case "defect":
            raise RuntimeError("a bug")
    if stage == "report":
        Path(folder, "report-1.html").write_text("<p>report</p>")
        return {"error": None, "reports": ["1"]}
    return {"error": None, **({"cables": [CABLE]} if stage == "measure" else {})}
