"""Interrupts and lack of memory: raised as what they are; how much memory is left; results written briefly."""

import inspect
import subprocess
import sys

import numpy as np
import pytest

import loewner
from loewner import Body, CollisionChecker, Ellipsoids, InputError, MemoryLimitError, Polytope, Robot, Scene, Verdict
from loewner._base import _guard, _memory, _validate
from loewner._native import entries, singles
from sampling import quick


def chained(error: BaseException, links: int) -> SystemError:
    """What Python makes of an error that was set while a kernel handed back its arrays."""
    for _ in range(links):
        fault = SystemError("returned a result with an exception set")
        fault.__cause__ = error
        error = fault
    return error


@pytest.mark.parametrize("links", [1, 2, 5])
def test_an_interrupt_is_found_behind_faults(links):
    """However many arrays were handed back after it; a fault of its own stays one."""

    @_guard.guarded
    def interrupted():
        raise chained(KeyboardInterrupt(), links)

    @_guard.guarded
    def timed_out():
        raise chained(TimeoutError("a handler's own"), links)

    @_guard.guarded
    def broken():
        raise chained(SystemError("bad"), links - 1)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(TimeoutError, match="a handler's own"):
        timed_out()
    with pytest.raises(SystemError):
        broken()


def test_memory_that_runs_out_is_ours():
    """With what was asked for and what is left; also behind faults, and once only."""

    @_guard.guarded
    def starved(links):
        raise chained(MemoryError("Unable to allocate 7 GiB"), links)

    for links in (0, 2):
        with pytest.raises(MemoryLimitError, match="Unable to allocate 7 GiB .* GiB"):
            starved(links)
    refused = MemoryLimitError("as it was")
    assert _guard.meant(refused) is refused
    assert issubclass(MemoryLimitError, (InputError, MemoryError))


@pytest.mark.parametrize("query", [loewner.classify, loewner.collide])
@pytest.mark.parametrize("count", [1, 3])
def test_queries_guard_their_quick_way_too(query, count, monkeypatch):
    """An interrupt inside a kernel reaches the caller as KeyboardInterrupt, for one pair and for several.

    The extension's own query of one pair runs no Python that could be interrupted, and is left out.
    """

    def interrupted(*_):
        raise chained(KeyboardInterrupt(), 2)

    monkeypatch.setattr(singles, query.__name__, singles.none)
    monkeypatch.setattr(entries, "settle_range", interrupted)
    ball, T = Body.sphere(1.0), np.eye(4) if count == 1 else np.tile(np.eye(4), (count, 1, 1))
    with pytest.raises(KeyboardInterrupt):
        query(ball, None, ball, T)


def is_guarded(function):
    """Whether `guarded` has wrapped a function: it then has the code of every guarded function."""
    return function.__code__ is _guard.guarded(print).__code__


def test_what_makes_arrays_is_guarded():
    """All public functions but three, which guard what they call; and the methods of these classes."""
    inside = {"classify", "collide", "distance"}
    for name in loewner.__all__:
        thing = getattr(loewner, name)
        if inspect.isfunction(thing):
            assert is_guarded(thing) or name in inside, name
    for cls in (Body, loewner.Bodies, CollisionChecker, Ellipsoids, Polytope, Scene):
        for name, member in vars(cls).items():
            function = getattr(member, "__func__", member)
            if inspect.isfunction(function) and not name.startswith("_"):
                assert is_guarded(function), f"{cls.__name__}.{name}"
    assert is_guarded(Robot.forward_kinematics)


def write(root, files):
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


STAT = "anon 5\nactive_file 100\ninactive_file 300\n"
OLD_STAT = "active_file 1\ntotal_active_file 100\ntotal_inactive_file 300\n"
NEW = "30 23 0:26 / /sys/fs/cgroup rw,nosuid - cgroup2 cgroup2 rw\n"
OLD = "36 32 0:33 / /sys/fs/cgroup/memory rw - cgroup cgroup rw,memory\n35 32 0:3 / /sys/x rw - cgroup c rw,cpu\n"


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        # Of nested groups the tightest counts, wherever it is; cached files are no loss.
        ({"sys/fs/cgroup/a/b/memory.max": "5000", "sys/fs/cgroup/a/b/memory.current": "1000"}, 4000),
        (
            {
                "sys/fs/cgroup/a/b/memory.max": "max",
                "sys/fs/cgroup/a/memory.max": "3000",
                "sys/fs/cgroup/a/memory.current": "1000",
                "sys/fs/cgroup/a/memory.stat": STAT,
                "sys/fs/cgroup/memory.max": "9000",
            },
            2400,
        ),
        ({"sys/fs/cgroup/a/b/memory.max": "1000", "sys/fs/cgroup/a/b/memory.current": "1200"}, 0),
        ({"sys/fs/cgroup/a/b/memory.max": "max"}, 2**30),
        # A container that sees its host's path, and only its own part of the tree.
        ({"sys/fs/cgroup/memory.max": "7000", "sys/fs/cgroup/memory.current": "0"}, 7000),
    ],
)
def test_control_groups_of_the_second_kind(files, expected, tmp_path):
    """Of nested control groups (version 2) the tightest limit counts, and cached files count as free."""
    write(tmp_path, {"proc/self/cgroup": "0::/a/b\n", "proc/self/mountinfo": NEW, **files})
    write(tmp_path, {"proc/meminfo": f"MemTotal: 9 kB\nMemAvailable: {2**20} kB\n"})
    assert _memory.left(tmp_path)[0] == expected


def test_control_groups_of_the_first_kind(tmp_path):
    """The limit of a control group (version 1) counts, and its cached files count as free."""
    write(tmp_path, {"proc/self/cgroup": "4:memory:/jobs/one\n3:cpu:/\n0::/\n", "proc/self/mountinfo": OLD})
    write(tmp_path, {"sys/fs/cgroup/memory/jobs/one/memory.limit_in_bytes": str(2**63 - 4096)})
    group = tmp_path / "sys/fs/cgroup/memory/jobs"
    write(group, {"memory.limit_in_bytes": "9000\n", "memory.usage_in_bytes": "2000\n", "memory.stat": OLD_STAT})
    assert _memory.left(tmp_path) == (7400, " left in this control group")


def test_where_no_limit_is_known_there_is_none(tmp_path):
    """Without any known limit memory counts as unlimited; on Linux this machine's is known."""
    assert _memory.left(tmp_path) == (sys.maxsize, "")
    assert 0 < _memory.left()[0] < sys.maxsize or sys.platform != "linux"


def test_a_large_request_is_held_against_the_limits(monkeypatch):
    """And the message says how much it would take, how much there is, and who says so."""
    monkeypatch.setattr(_memory, "left", lambda: (2**27, " left by RLIMIT_AS"))
    _validate.fits_memory(2**27, "few")
    with pytest.raises(MemoryLimitError, match=r"0\.125 GiB left by RLIMIT_AS\), found many, which need 0\.25 GiB"):
        _validate.fits_memory(2**28, "many")
    ball, T = Body.sphere(1.0), np.tile(np.eye(4), (20_000, 1, 1))
    calls = (
        lambda: loewner.collide(ball, T[:, None], ball, T),
        lambda: loewner.distance(ball, T[:, None], ball, T),
        lambda: loewner.overlapping_pairs(ball, T),
        lambda: loewner.Bodies.spheres(np.ones(1000))[np.zeros(1_000_000, dtype=int)],
        lambda: loewner.distance(ball, T, ball, T, pairs=np.zeros((4_000_000, 2), dtype=int)),
    )
    for call in calls:
        with pytest.raises(MemoryLimitError, match="GiB left by RLIMIT_AS"):
            call()


STARVED = """
import resource
import loewner
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {room} * 2**20, -1))
try:
    loewner.collide(loewner.Body.{body}, None, loewner.Body.sphere(1.0), None)
except loewner.MemoryLimitError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not enforce the limit")
@pytest.mark.parametrize(
    ("body", "loaded"),
    [
        ("sphere(1.0)", "compiled kernels"),
        pytest.param("box([1, 1, 1])", "compiled kernels", marks=pytest.mark.verify),
        ("from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])", "compiled kernels and SciPy"),
    ],
)
@pytest.mark.parametrize("room", quick(1, 50))
def test_what_has_to_be_loaded_does_not_crash(body, loaded, room):
    """OpenBLAS and LLVM abort the process where they find no place."""
    code = STARVED.format(room=room, body=body)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    assert f"address space to load {loaded}, found" in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not enforce the limit")
def test_what_is_loaded_already_needs_no_place_again():
    """With all of it loaded, a call works in a tenth of the address space that the first one asks for."""
    body = "from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])"
    query = f"loewner.collide(loewner.Body.{body}, None, loewner.Body.sphere(1.0), None)\n"
    code = STARVED.format(room=32, body=body).replace("used =", f"{query}used =")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout == ""


def test_a_verdict_is_written_by_its_name():
    """A verdict is printed as its name, without its class."""
    assert [str(verdict) for verdict in Verdict] == ["FREE", "COLLIDING", "AMBIGUOUS"]
    assert f"{Verdict.FREE}" == "FREE"


def test_results_are_written_on_a_few_lines():
    """However long their arrays are; of one pair with its numbers."""
    ball, T = Body.sphere(1.0), np.tile(np.eye(4), (1000, 1, 1))
    T[:, 0, 3] = 3.0
    one, many = (loewner.distance(ball, None, ball, x, exact=True) for x in (T[0], T))
    assert "distance=1.0, witness_a=[1., 0., 0.]" in repr(one)
    assert "distance=<(1000,) float64>, witness_a=<(1000, 3) float64>" in repr(many)
    assert "None" not in repr(loewner.distance(ball, None, ball, T))
    fit = loewner.mvce(np.random.default_rng(0).normal(size=(500, 40)))
    assert max(len(repr(x)) for x in (one, many, fit, fit.ellipsoid)) < 400


def test_an_interrupt_that_numba_loses():
    """NumPy's complaint about the type of an array that Numba could not fetch stands for the interrupt behind it."""
    assert type(_guard.meant(chained(ValueError(_guard.LOST_INTERRUPT), 2))) is KeyboardInterrupt
    other = ValueError("another")
    assert _guard.meant(chained(other, 2)) is other
