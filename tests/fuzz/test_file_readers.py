"""Every reader of files: what the seeds of `fuzz_bytes.py` say, and a little damage without its fuzzer."""

import random
import tempfile
import warnings
from functools import cache
from pathlib import Path

import pytest

import driver
from file_readers import READERS
from loewner import LoewnerError
from sampling import quick


def read(name: str, data: bytes) -> None:
    """Read bytes as a file of a format; warnings are nothing."""
    reader = READERS[name]
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder, "file" + reader.suffix)
        path.write_bytes(data)
        reader.read(path)


@cache
def seeds_of(name: str) -> list[bytes]:
    """Small files of a format."""
    return READERS[name].seeds()


@pytest.mark.parametrize("name", READERS)
def test_a_valid_file_is_read(name: str):
    """Of each format at least one seed is read, or the fuzzer would start from nothing."""
    seeds, refused = seeds_of(name), []
    for seed in seeds:
        try:
            read(name, seed)
        except LoewnerError as error:
            refused.append(str(error))
    assert len(refused) < len(seeds), refused


def damaged(seed: bytes, rng: random.Random) -> bytes:
    """A seed that is cut, or in which bytes are others, missing, or twice."""
    data, a = bytearray(seed), rng.randrange(len(seed))
    b = min(len(seed), a + rng.choice([1, 1, 4, 50]))
    change = rng.randrange(5)
    if change == 0:
        return seed[:a]
    if change == 1:
        del data[a:b]
    elif change == 2:
        data[a:a] = seed[a:b] * rng.choice([1, 2, 100])
    else:
        words = [b"9" * 30, b"-", b"nan", b"\0", b"{", b"<", b"("]
        data[a:b] = rng.randbytes(b - a) if change == 3 else rng.choice(words)
    return bytes(data)


@cache
def outcomes(count: int) -> dict[str, list[driver.Outcome]]:
    """What becomes of as many damaged files of each format, read one after the other in another process."""
    cases = []
    for name in READERS:
        rng = random.Random(name)
        cases += [(name, damaged(rng.choice(seeds_of(name)), rng)) for _ in range(count)]
    became: dict[str, list[driver.Outcome]] = {name: [] for name in READERS}
    for outcome in driver.run(lambda case: read(*case), cases):
        became[outcome.case[0]].append(outcome)
    return became


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("count", quick(10, 25))
def test_damage_is_refused_or_read(name: str, count: int):
    """A damaged file gives a value or a child of LoewnerError: no other exception, no crash, no hang."""
    assert not driver.faults(outcomes(count)[name])
