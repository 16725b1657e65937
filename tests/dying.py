"""Tasks of `loewner fit` over one of which the process dies: a stand-in for one that runs out of memory."""

import os

from loewner.cli import fit


def serve_task(task, progress):
    """Fit a mesh, unless it is the deadly one."""
    if "deadly" in task["mesh"]:
        os.abort()
    return fit.serve_task(task, progress)
