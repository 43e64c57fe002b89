"""The process in which tasks run: a line of JSON in for each, a line of JSON out.

It ends at once, whatever it is doing, when its input is closed: it does not outlive who started it. Standard output is
kept for the answers; what else a library writes there goes to standard error.
"""

import faulthandler
import json
import os
import queue
import sys
import threading

from cablejax.batch.task import Task, call

# A process may have 65,530 memory maps; each program that jax compiles takes some, and none is given back.
MOST_MAPS = 30_000


def main() -> None:
    """Work until the input ends."""
    faulthandler.enable()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    from cablejax.runtime import set_up_jax_when_used

    set_up_jax_when_used()
    tasks: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(tasks,), daemon=True).start()
    while True:
        outcome = call(Task(*json.loads(tasks.get())))
        last = _maps() > MOST_MAPS
        answers.write(json.dumps([*outcome, last]) + "\n")
        answers.flush()
        if last:
            return


def _listen(tasks: "queue.SimpleQueue[str]") -> None:
    """Take tasks from standard input, and end the process with it."""
    for line in sys.stdin:
        tasks.put(line)
    os._exit(0)


def _maps() -> int:
    try:
        with open("/proc/self/maps", "rb") as file:
            return sum(1 for _ in file)
    except OSError:  # not Linux
        return 0
