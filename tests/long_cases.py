"""Lists the cases of the quick suite that take long: a plugin that `conftest.py` registers.

A case should take at most `LONG` seconds of its process's time. If a longer one cannot leave a part of its samples to
`verify`, it has the mark ``slow("reason")``. Nothing fails here, since a change is not at fault for a busy or slow
machine: a table follows the run, and under ``CI=true`` each case without the mark is a line that GitHub shows as a
warning.
"""

import os
import time

import pytest

LONG = 5.0  # processor seconds of the process that runs the case, with its fixtures
STARTED = pytest.StashKey[float]()
KEY = "processor seconds"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    item.stash[STARTED] = time.process_time()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Add the time and the reason to a case's last report, which also comes from other processes."""
    report = yield
    if call.when == "teardown":
        mark = item.get_closest_marker("slow")
        reason = "verify" if item.get_closest_marker("verify") else mark.args[0] if mark else ""
        report.user_properties.append((KEY, (time.process_time() - item.stash[STARTED], reason)))
    return report


def pytest_terminal_summary(terminalreporter):
    """Print the long cases, the longest first."""
    reports = [report for found in terminalreporter.stats.values() for report in found if hasattr(report, "when")]
    timed = [
        (*value, report) for report in reports if report.when == "teardown" for key, value in report.user_properties
        if key == KEY
    ]  # fmt: skip
    long = sorted((case for case in timed if case[0] > LONG and case[1] != "verify"), key=lambda case: -case[0])
    if long:
        terminalreporter.section(f"cases above {LONG:g} s of processor time")
    for seconds, reason, report in long:
        terminalreporter.write_line(f"{seconds:5.1f} s {report.nodeid}: {reason or 'without a mark slow(reason)'}")
        if not reason and os.environ.get("CI") == "true":
            path, line, _ = report.location
            title = f"{seconds:.1f} s without a mark slow(reason)"
            terminalreporter.write_line(f"::warning file={path},line={line + 1}::{report.nodeid}: {title}")
