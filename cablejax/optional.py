"""Packages that the core does without: where one is missing, one sentence says which extra brings it."""

import importlib.util

EXTRAS: dict[str, str] = {
    "laspy": "scan",
    "pye57": "scan",
    "matplotlib": "scan",
    "cycler": "scan",
    "plotly": "scan",
    "jinja2": "scan",
    "markupsafe": "scan",
    "tensorboardX": "study",
    "hydra": "study",
    "omegaconf": "study",
    "nbformat": "notebooks",
    "nbclient": "notebooks",
    "nbconvert": "notebooks",
    "open3d": "peers",
    "libusb_package": "peers",
    "distributed": "cluster",
    "ezdxf": "cad",
    "wandb": "track",
}


class MissingPackageError(ImportError):
    """A package of an extra is not installed; the message says which extra brings it."""


def require(*packages: str, why: str) -> None:
    """Look for packages before they are imported.

    Args:
        packages: As they are imported: "tensorboardX".
        why: What they are needed for, to begin the sentence with: "the report".

    Raises:
        MissingPackageError: If one is missing, naming it and the extra that brings it.

    Example:
        >>> require("json", why="this example")
        >>> EXTRAS["no_such_package"] = "scan"
        >>> require("no_such_package", why="this example")
        Traceback (most recent call last):
        cablejax.optional.MissingPackageError: this example needs no_such_package: pip install "cablejax[scan]"
    """
    missing = [name for name in packages if importlib.util.find_spec(name) is None]
    if missing:
        extras = ",".join(dict.fromkeys(EXTRAS[name] for name in missing))
        raise MissingPackageError(
            f'{why} needs {" and ".join(missing)}: pip install "cablejax[{extras}]"', name=missing[0]
        )
