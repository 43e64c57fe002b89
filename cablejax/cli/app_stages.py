"""The work on a scan that lies on the page's desk, stage by stage, in a process beside the page."""

import argparse
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cablejax.cli import measure, measure_input, standards
from cablejax.cli.arguments import add_output
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import load
from cablejax.cli.streams import warnings_told
from cablejax.optional import MissingPackageError

if TYPE_CHECKING:
    from cablejax.io import PointFile
    from cablejax.measure import CableMeasurement, CableScene

Found = dict[str, Any]


def stage(stage: str, path: str, arguments: list[str], folder: str) -> Found:
    """One of `STAGES`, for `cablejax.app.Desk`: `error`, a sentence or None, and what was found.

    The stages of one scan follow each other in one process, which keeps what the ones before have found.
    """
    if stage == "read":
        _work.cache_clear()
    with warnings_told() as told:
        try:
            found = {"error": None, **STAGES[stage](_work(path, tuple(arguments)), Path(folder))}
        except (NoResultError, MissingPackageError) as error:
            found = {"error": str(error)}
    # On the page there is a unit to choose, and no option.
    plain = [text.replace("no --unit given", "no unit was chosen") for text in told]
    return found | ({"warnings": plain} if stage == "read" else {})


@functools.lru_cache(maxsize=1)
def _work(path: str, arguments: tuple[str, ...]) -> "_Work":
    return _Work(path, arguments)


class _Work:
    """A scan and what is known of it, each found when it is first asked for."""

    def __init__(self, path: str, arguments: Sequence[str]):
        self.path, self.arguments = path, arguments

    @functools.cached_property
    def options(self) -> argparse.Namespace:
        parser = argparse.ArgumentParser(prog="cablejax measure")
        measure.add_arguments(parser)
        add_output(parser)
        parser.set_defaults(command="measure")
        try:
            options = parser.parse_args([*self.arguments, "--", self.path])
        except SystemExit:
            raise NoResultError(f"{' '.join(self.arguments)}: are no options of `cablejax measure`") from None
        measure_input.check_tolerance(options)
        return options

    @functools.cached_property
    def known(self) -> Found:
        """What is given to a measurement beside the points."""
        return measure_input.given(self.options)

    @functools.cached_property
    def scan(self) -> "PointFile":
        return load(self.options, self.path)

    @functools.cached_property
    def first(self) -> "CableMeasurement | NoResultError":
        """As `cablejax measure` finds it."""
        from cablejax.measure import MeasureError

        try:
            return measure_input.measured(self.options, self.scan, None, self.known)[0]
        except MeasureError as error:
            return NoResultError(f"{self.path}: {error}")

    @functools.cached_property
    def scene(self) -> "CableScene":
        """As `cablejax measure --all` finds them."""
        from cablejax.measure import MeasureError, measure_cables

        try:
            return measure_cables(self.scan.xyz_mm, **self.known)
        except MeasureError as error:
            raise NoResultError(f"{self.path}: {error}") from None

    @property
    def every(self) -> bool:
        """Whether there are several."""
        return len(self.scene.cables) > 1

    @property
    def cables(self) -> "Sequence[CableMeasurement]":
        """All cables where they are several; else the one of `cablejax measure`, which looks at a single one more closely.

        Raises:
            NoResultError: If that refuses it.
        """
        if self.every:
            return self.scene.cables
        if isinstance(self.first, NoResultError):
            raise self.first
        return [self.first]


def _read(work: _Work, folder: Path) -> Found:
    from cablejax.app.view import write_cloud

    assert work.known is not None  # what cannot be asked for is said before a large file is read
    scan = work.scan
    about = {"unit": scan.unit, "dropped": scan.dropped, "tolerance_mm": work.options.tolerance}
    return {**about, "cables": [], "cloud": write_cloud(folder / "cloud.bin", scan.xyz_mm, [])}


def _measure(work: _Work, folder: Path) -> Found:
    if isinstance(work.first, NoResultError):
        raise work.first
    return _views(work, folder, [work.first])


def _every(work: _Work, folder: Path) -> Found:
    try:
        scene = work.scene
    except NoResultError as error:
        raise (work.first if isinstance(work.first, NoResultError) else error) from None
    cables, said = work.cables, list(scene.warnings)
    if isinstance(work.first, NoResultError):
        said.append(f"`cablejax measure`, which looks for one cable alone, gives no result: {work.first}")
    missed = [{"diameter_mm": one.diameter_mm, "reason": one.reason} for one in scene.not_measured]
    found = {"every": work.every, "not_measured": missed, "scene_warnings": said}
    return found | (_views(work, folder, cables) if work.every else {})


def _views(work: _Work, folder: Path, cables: "Sequence[CableMeasurement]") -> Found:
    """What the page is told of cables, and the files that it draws them from."""
    from cablejax.app.view import cable_view, write_cloud, write_surfaces

    limits, views = work.options.tolerance, []
    for number, one in enumerate(cables, 1):
        said = standards.as_json(*standards.read_and_sized(one, limits))
        sure = measure_input.conformity_of(work.options, one.diameter_mm, one.std_mm)
        views.append({**cable_view(number, one), **said, "conformity": sure})
    write_surfaces(folder, cables)
    return {"cables": views, "cloud": write_cloud(folder / "cloud.bin", work.scan.xyz_mm, cables)}


def _report(work: _Work, folder: Path) -> Found:
    from cablejax.report import cables_page, measurement_page

    xyz_mm, name, pages = work.scan.xyz_mm, Path(work.path).name, {}
    about = f"{name}, read in {work.scan.unit}"
    for number, one in enumerate(work.cables, 1):
        title = f"{name}, cable {number}" if work.every else name
        pages[str(number)] = measurement_page(one, title=title, source=about, xyz_mm=xyz_mm)  # pyright: ignore[reportArgumentType] frozen
    if work.every:
        pages["all"] = cables_page(work.scene, title=name, source=about, xyz_mm=xyz_mm)  # pyright: ignore[reportArgumentType]
    for which, html in pages.items():
        (folder / f"report-{which}.html").write_bytes(html.encode(errors="backslashreplace"))
    return {"reports": list(pages)}


STAGES = {"read": _read, "measure": _measure, "every": _every, "report": _report}
