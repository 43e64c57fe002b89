"""Execute the notebooks, which read results/ and draw, and keep their output.

python -m experiments.notebooks [--check]
"""

import argparse
from pathlib import Path

from experiments import ROOT

TIMEOUT_S = 900


def execute(path: Path, *, folder: Path = ROOT) -> str:
    """Run a notebook.

    Args:
        path: The notebook.
        folder: Working folder; the repository's root, where Jupyter would take the notebook's own.

    Returns:
        The executed notebook as JSON text, without the timestamps and versions that differ from run to run.

    Raises:
        nbclient.exceptions.CellExecutionError: If a cell fails.
        RuntimeError: If a cell warns, or says anything else on standard error, which readers should not meet.
    """
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    NotebookClient(
        notebook,
        timeout=TIMEOUT_S,
        startup_timeout=TIMEOUT_S,
        resources={"metadata": {"path": str(folder)}},
        extra_arguments=["--Application.log_level=ERROR"],  # it warns that a kernel on this machine is not encrypted
    ).execute()
    for cell in notebook.cells:
        said = [output.text for output in cell.get("outputs", []) if output.get("name") == "stderr"]
        if said:
            raise RuntimeError(f"{path.name}: a cell said on standard error: {said[0]}")
        cell.metadata.pop("execution", None)
    notebook.metadata.pop("language_info", None)
    return nbformat.writes(notebook) + "\n"


def main() -> None:
    """Execute every notebook; with `--check` write nothing."""
    parser = argparse.ArgumentParser(prog="python -m experiments.notebooks", description="Execute the notebooks.")
    parser.add_argument("--check", action="store_true", help="execute, but write nothing")
    options = parser.parse_args()
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text = execute(path)
        if not options.check:
            path.write_text(text, encoding="utf-8")
        print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
