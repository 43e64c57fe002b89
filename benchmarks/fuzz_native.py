"""Run the reader of LAS and E57 files on many files quickly: a process that has the libraries, forked for every file.

    python -P benchmarks/fuzz_native.py las|e57 CHILD.py FOLDER SECONDS MEMORY_BYTES

Reads paths from standard input and answers each with a line of JSON. Started by `fuzz_readers.py`; like `child.py`, it
imports nothing of cablejax, for a process that runs JAX must not be forked.
"""

import importlib.util
import io
import json
import os
import signal
import sys
import time


def load(path):
    """The module in a file, without its package."""
    spec = importlib.util.spec_from_file_location("child", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read(child, kind, path, answer, memory_bytes):
    """In the forked process: what `child.py` would send, reduced to counts."""
    out = io.BytesIO()
    child.own_output()
    child.main(kind, path, memory_bytes, 0, out)
    out.seek(0)
    points = dropped = 0
    finite, notes = True, []
    while True:
        frame = json.loads(out.readline())
        if "error" in frame:
            break
        dropped += frame["dropped"]
        notes += frame["notes"]
        for name, (dtype, shape) in frame["arrays"].items():
            values = child.np.frombuffer(out.read(child.np.dtype(dtype).itemsize * int(child.np.prod(shape))), dtype)
            if name == "xyz":
                points += shape[0]
                finite &= bool(child.np.isfinite(values).all())
    with open(answer, "w") as file:
        found = {"points": points, "dropped": dropped, "finite": finite, "notes": notes}
        json.dump({"error": frame["error"], **found}, file)


def judge(child, kind, path, answer, seconds, memory_bytes):
    """Read one file in a process of its own and say how it ended."""
    if os.path.exists(answer):
        os.remove(answer)
    start, pid = time.monotonic(), os.fork()
    if pid == 0:
        read(child, kind, path, answer, memory_bytes)
        os._exit(0)
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            break
        if time.monotonic() - start > seconds:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            return {"outcome": "stopped"}
        time.sleep(0.001)
    if status or not os.path.exists(answer):
        return {"outcome": "died", "status": status}
    with open(answer) as file:
        result = json.load(file)
    return {"outcome": "refused" if result["error"] else "read", **result}


def main():
    kind, child_path, folder, seconds, memory_bytes = sys.argv[1:]
    child = load(child_path)
    if kind == "las":
        import laspy  # noqa: F401 (imported before the forks)
    else:
        import pye57  # noqa: F401
    for line in sys.stdin:
        result = judge(
            child, kind, line.rstrip("\n"), os.path.join(folder, "answer"), float(seconds), int(memory_bytes)
        )
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
