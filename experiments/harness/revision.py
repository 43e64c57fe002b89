"""Which code made a number: the last commit that touched the code, and a digest of what is not committed."""

import hashlib
import subprocess
from functools import cache

from experiments import ROOT

CODE = ("cablejax", "experiments", "conf", "requirements")


def _git(*args: str) -> str | None:
    try:
        done = subprocess.run(["git", "-C", str(ROOT), *args], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout


@cache
def code_revision() -> str:
    """The revision of the code alone, so that a new README does not make finished runs stale.

    Returns:
        The last commit that touched the code; with `+` and a digest of the difference where the work tree differs from
        it; or `unversioned+` and a digest of the sources outside a git checkout.
    """
    commit = _git("log", "-1", "--format=%H", "--", *CODE)
    if commit:
        difference = _git("diff", "HEAD", "--", *CODE) or ""
        new = _git("ls-files", "--others", "--exclude-standard", "--", *CODE) or ""
        contents = "".join((ROOT / name).read_text(errors="replace") for name in new.splitlines())
        digest = hashlib.sha256((difference + new + contents).encode()).hexdigest()[:10]
        return commit.strip() + (f"+{digest}" if difference or new else "")
    sources = sorted(path for folder in CODE for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".yaml"))
    return "unversioned+" + hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:10]


def is_clean(revision: str) -> bool:
    """Whether a revision names committed code exactly."""
    return "+" not in revision
