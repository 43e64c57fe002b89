"""The scans on the desk and the work on them, one after the other, in a process of its own beside the page."""

import contextlib
import itertools
import queue
import shutil
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cablejax.app.section import section
from cablejax.app.settings import arguments_of, command_of
from cablejax.batch import Outcome, Task
from cablejax.batch.child import Child, ClosedError

# In this order; each leaves files in the scan's folder and returns what the page is told.
STAGES = {
    "read": "reading",
    "measure": "measuring",
    "every": "looking for further cables",
    "report": "writing the reports",
}
WAITING, DONE, STOPPED = "waiting", "done", "stopped"


@dataclass
class Sheet:
    """A scan on the desk.

    Attributes:
        number: Of the scan, from 1, never given twice.
        path: The file.
        folder: For what is found.
        settings: As `arguments_of` takes them.
        stage: What is being done, a value of `STAGES`, or that it waits, is done, or was stopped.
        since: When that began, `time.monotonic()`.
        error: Why there is no result, in one sentence.
        found: What the stages returned, each over the ones before.
        version: How often anything changed.
        seconds: That the work took until the numbers were there; None before.
    """

    number: int
    path: Path
    folder: Path
    settings: dict[str, Any]
    own: bool = False
    stage: str = WAITING
    since: float = field(default_factory=time.monotonic)
    error: str | None = None
    found: dict[str, Any] = field(default_factory=dict)
    version: int = 0
    run: int = 0
    seconds: float | None = None

    @property
    def busy(self) -> bool:
        """Whether it waits or is worked on."""
        return self.stage == WAITING or self.stage in STAGES.values()

    def short(self) -> dict[str, Any]:
        """Its line in the list of scans."""
        cables = [
            {name: one[name] for name in ("number", "diameter_mm", "interval_mm")}
            for one in self.found.get("cables", ())
        ]
        return {
            "number": self.number, "name": self.path.name, "stage": self.stage, "busy": self.busy, "error": self.error,
            "version": self.version, "cables": cables, "elapsed": time.monotonic() - self.since,
        }  # fmt: skip

    def whole(self) -> dict[str, Any]:
        """All that is known of it."""
        every = bool(self.found.get("every"))
        command = command_of(self.path.name, self.settings, every=every)
        known = {"settings": self.settings, "command": command, "seconds": self.seconds}
        return {"warnings": [], "parts": {}, **self.short(), **self.found, **known}


class Desk:
    """Scans, measured one after the other; any thread may call any method.

    Args:
        work: What does a stage, "package.module:function", called in another process with `stage`, `path`, `arguments`
            (options of `cablejax measure`) and `folder`. It returns `error`, a sentence or None, and what is found.
        folder: For uploaded files and results.
    """

    def __init__(self, work: str, folder: Path):
        self._work, self._folder = work, folder
        self._sheets: dict[int, Sheet] = {}
        self._numbers = itertools.count(1)
        self._todo: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._child = Child()
        self._at_work: int | None = None
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def place(self) -> Path:
        """A new folder, for an uploaded file."""
        path = self._folder / f"upload-{next(self._numbers)}"
        path.mkdir(parents=True)
        return path

    def add(self, path: Path, settings: Mapping[str, Any], *, own: bool = False) -> int:
        """Put a file on the desk to be measured; its number.

        Args:
            path: The file.
            settings: As `arguments_of` takes them.
            own: Whether the file and its folder are the desk's and go with the sheet.

        Raises:
            ValueError: If a setting is none.
        """
        arguments_of(settings)
        number = next(self._numbers)
        folder = self._folder / f"scan-{number}"
        folder.mkdir(parents=True)
        with self._lock:
            self._sheets[number] = Sheet(number, path, folder, dict(settings), own)
        self._todo.put(number)
        return number

    def again(self, number: int, settings: Mapping[str, Any]) -> None:
        """Measure a scan anew with other settings; what is under way for it is given up.

        Raises:
            KeyError: If there is no such scan.
            ValueError: If a setting is none.
        """
        arguments_of(settings)
        self.stop(number)
        with self._lock:
            sheet = self._sheets[number]
            kept = {name: sheet.found[name] for name in ("cloud",) if name in sheet.found}
            sheet.settings, sheet.found, sheet.error, sheet.seconds = dict(settings), kept, None, None
            self._change(sheet, WAITING)
        self._todo.put(number)

    def stop(self, number: int) -> None:
        """Give up the work on a scan.

        Raises:
            KeyError: If there is no such scan.
        """
        with self._lock:
            sheet = self._sheets[number]
            sheet.run += 1
            if sheet.busy:
                self._change(sheet, STOPPED)
            if self._at_work == number:
                self._child.close()

    def remove(self, number: int) -> None:
        """Take a scan off the desk, and what was found with it.

        Raises:
            KeyError: If there is no such scan.
        """
        self.stop(number)
        with self._lock:
            sheet = self._sheets.pop(number)
        shutil.rmtree(sheet.folder, ignore_errors=True)
        if sheet.own:
            shutil.rmtree(sheet.path.parent, ignore_errors=True)

    def scans(self) -> list[dict[str, Any]]:
        """A line a scan."""
        with self._lock:
            return [sheet.short() for sheet in self._sheets.values()]

    def scan(self, number: int) -> dict[str, Any]:
        """All about a scan.

        Raises:
            KeyError: If there is no such scan.
        """
        with self._lock:
            return self._sheets[number].whole()

    def file(self, number: int, name: str) -> tuple[Path, str]:
        """A file that a stage left for a scan, and the name of the scan.

        Raises:
            KeyError: If there is no such scan or file.
        """
        with self._lock:
            sheet = self._sheets[number]
        path = sheet.folder / name
        if Path(name).name != name or not path.is_file():
            raise KeyError(name)
        return path, sheet.path.name

    def section(self, number: int, cable: int, at_mm: float) -> dict[str, Any]:
        """The section of a cable at a place along it, an eighth of the diameter to either side.

        Raises:
            KeyError: If there is no such scan or cable.
        """
        surface, _ = self.file(number, f"surface-{cable}.npy")
        found = {one["number"]: one["diameter_mm"] for one in self.scan(number)["cables"]}
        half = found[cable] / 8
        return {"at_mm": at_mm, "half_mm": half, **section(surface, at_mm=at_mm, half_mm=half)}

    def close(self) -> None:
        """End the work and its process."""
        with self._lock:
            numbers = list(self._sheets)
        for number in numbers:
            with contextlib.suppress(KeyError):
                self.stop(number)
        self._todo.put(None)
        self._thread.join()
        self._child.bury()

    def _loop(self) -> None:
        """Work on one scan after the other."""
        while (number := self._todo.get()) is not None:
            with self._lock:
                sheet = self._sheets.get(number)
                if sheet is None or sheet.stage != WAITING:
                    continue
                self._at_work, run = number, sheet.run
                if self._child.closed:
                    self._child.bury()
                    self._child = Child()
            try:
                self._measure(sheet, run)
            except ClosedError:
                pass  # given up
            finally:
                with self._lock:
                    self._at_work = None

    def _measure(self, sheet: Sheet, run: int) -> None:
        """All stages, until one says that there is no result.

        Raises:
            ClosedError: If it was stopped.
        """
        began = time.monotonic()
        for stage, told in STAGES.items():
            with self._lock:
                if sheet.run != run:
                    return
                self._change(sheet, told)
                arguments = arguments_of(sheet.settings)
            # The file by its name alone, for that is how the sentences name it.
            about = {"stage": stage, "path": sheet.path.name, "arguments": arguments, "folder": str(sheet.folder)}
            outcome = self._child.run(Task(stage, self._work, about, str(sheet.path.parent)))
            value = {"error": _in_words(outcome)} if outcome.kind != "returned" else dict(outcome.value)
            with self._lock:
                if sheet.run != run:
                    return
                sheet.error = value.pop("error")
                sheet.found |= value
                if stage == "every":
                    sheet.seconds = time.monotonic() - began
                if sheet.error is not None and stage != "measure":
                    break  # a scan whose first cable cannot be measured may hold others that can
        with self._lock:
            self._change(sheet, DONE)

    def _change(self, sheet: Sheet, stage: str) -> None:
        sheet.stage, sheet.version = stage, sheet.version + 1
        sheet.since = time.monotonic()


def _in_words(outcome: Outcome) -> str:
    if outcome.kind == "raised":
        return f"a defect of this program, please report it: {outcome.reason}"
    return f"the work on it {outcome.reason}" if outcome.reason.startswith("took") else outcome.reason
