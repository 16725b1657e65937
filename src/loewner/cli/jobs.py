"""Distribute files to several processes, one file at a time. If a process dies, only its current file is lost.

Each process is a new interpreter that reads tasks from its standard input and writes answers to its standard output.
Every task and every answer is a line of JSON. A process ends when its input ends: when all work is done, or when the
parent process has ended for any reason.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

import loewner
from loewner._base import _json


class Event(NamedTuple):
    """A process's report on a task: its start, its progress or its answer, which is None if the process died."""

    kind: str
    place: int
    value: Any = None


def answers(entry: str, tasks: Sequence[dict[str, Any]], jobs: int) -> Generator[Event, None, None]:
    """Distribute tasks to processes and yield the reports: ``begun``, ``progress`` (done, total) or ``answer``.

    Parameters
    ----------
    entry : str
        Module with a function ``serve_task`` that takes a task and a progress callback and returns the answer.
    tasks : sequence of dict
        The tasks, with values that JSON can represent.
    jobs : int
        Maximum number of processes that run at a time. Together, the processes use as many threads as this process may
        use.
    """
    jobs = min(jobs, len(tasks))
    waiting, said = SimpleQueue[int](), SimpleQueue[Event | None]()
    for place in range(len(tasks)):
        waiting.put(place)
    pool = _Pool(entry, max(1, loewner.get_num_threads() // max(1, jobs)))
    threads = [threading.Thread(target=_attend, args=(pool, tasks, waiting, said), daemon=True) for _ in range(jobs)]
    try:
        for thread in threads:
            thread.start()
        for _ in threads:  # each thread reports None at its end
            yield from iter(said.get, None)
    finally:
        pool.end()


class _Pool:
    """The running processes, so that all of them can be ended."""

    def __init__(self, entry: str, threads: int) -> None:
        home = str(Path(loewner.__file__).parent.parent)
        # An interrupt reaches all processes of a terminal, but only the parent reacts to it.
        self._command = [
            sys.executable, "-P", "-c",
            "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); import sys; "
            f"sys.path.insert(0, {home!r}); from loewner.cli.jobs import _serve; _serve({entry!r})",
        ]  # fmt: skip
        self._environment = {**os.environ, "LOEWNER_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
        self._lock, self._running, self._ended = threading.Lock(), set[subprocess.Popen[str]](), False

    def start(self) -> subprocess.Popen[str] | None:
        """Start another process; return None if all processes have been ended."""
        with self._lock:
            if self._ended:
                return None
            process = subprocess.Popen(
                self._command, env=self._environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8"
            )
            self._running.add(process)
            return process

    def end(self) -> None:
        """End all processes immediately."""
        with self._lock:
            self._ended = True
            for process in self._running:
                process.kill()
            for process in self._running:
                process.wait()


def _attend(pool: _Pool, tasks: Sequence[dict[str, Any]], waiting: SimpleQueue[int], said: SimpleQueue[Any]) -> None:
    """Give tasks to a process, one by one. If the process dies, continue with a new process."""
    process = None
    try:
        while True:
            place = waiting.get_nowait()
            process = process or pool.start()
            if process is None:
                return
            for report in _reports(process, place, tasks[place]):
                said.put(report)
            if report.value is None:
                process = None
    except Empty:
        pass
    finally:
        said.put(None)


def _reports(process: subprocess.Popen[str], place: int, task: dict[str, Any]) -> Iterator[Event]:
    """Give a task to a process, and yield its reports. If the process died, clean up."""
    assert process.stdin is not None
    assert process.stdout is not None
    yield Event("begun", place)
    try:
        process.stdin.write(json.dumps(task) + "\n")
        process.stdin.flush()
        for line in process.stdout:
            kind, value = _json.loads(line)
            yield Event(kind, place, value)
            if kind == "answer":
                return
    except (OSError, ValueError):  # the process closed its input, or died within a line
        pass
    process.kill()
    process.wait()
    yield Event("answer", place)


def _serve(entry: str) -> None:
    """Run the main loop of a process, which answers tasks. Text that a task prints goes to standard error."""
    from importlib import import_module

    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    tasks = SimpleQueue[str]()

    def read() -> None:
        for line in sys.stdin.buffer:
            tasks.put(line.decode())
        os._exit(0)

    def say(kind: str, value: Any) -> None:
        print(json.dumps([kind, value]), file=out, flush=True)

    threading.Thread(target=read, daemon=True).start()
    serve_task = import_module(entry).serve_task
    while True:
        task = _json.loads(tasks.get())
        say("answer", serve_task(task, lambda done, total: say("progress", [done, total])))
