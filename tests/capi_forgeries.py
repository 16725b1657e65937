"""Open copies of a file with a changed word, and ask those that open: the process must not crash or hang.

python tests/capi_forgeries.py FILE COUNT
"""

import ctypes
import struct
import sys
from pathlib import Path

import numpy as np

import capi
from loewner.bodies.native_files import checksum


def main(path: Path, count: int) -> None:
    content, rng = path.read_bytes(), np.random.default_rng(5)
    opened = 0
    for _ in range(count):
        made = bytearray(content)
        for _ in range(int(rng.integers(1, 4))):
            at = 8 * int(rng.integers(4, len(made) // 8))
            word = rng.integers(0, 2**64, dtype=np.uint64).tobytes() if rng.random() < 0.5 else struct.pack(
                "<d", rng.choice([0.0, -1.0, 1e18, -1e18, 1e300, 1e-300, 3.0])
            )  # fmt: skip
            made[at : at + 8] = word
        struct.pack_into("<Q", made, 24, checksum(bytes(made[32:])))
        path.write_bytes(made)
        try:
            checker = capi.Checker(path)
            opened += 1
            lower, upper = np.empty(checker.dof), np.empty(checker.dof)
            capi.ask("checker_limits", checker, lower, upper)
            Q = np.clip(rng.uniform(-1, 1, (20, checker.dof)), -1, 1)
            checker.verdicts("classify", Q)
            checker.verdicts("collide", Q)
            checker.distance(Q)
            checker.clearance(Q)
            checker.certify(Q[:10], Q[10:])
        except capi.Error:
            continue
    print(f"{opened} of {count} opened", ctypes.sizeof(ctypes.c_void_p))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
