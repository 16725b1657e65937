"""Check millions of pairs, configurations or motions on an NVIDIA GPU.

The GPU evaluates the formulas of the proofs in single precision, with bounds on the errors. The CPU decides the cases
that single precision leaves undecided, so the answers are the same as on the CPU alone. No software except the GPU's
driver is needed; the driver is loaded when a function here is first called.

`configurations` and `pairs` contain the public functions. `motions` proves motions, `tiles` allocates memory on the
GPU, `tables` copies the robot to the GPU, and `work` lists work for the CPU. `arrays` reads other libraries' arrays,
`driver` calls the driver, and `_ptx` generates the code.
"""

from loewner.gpu.arrays import DeviceArray
from loewner.gpu.configurations import Checker
from loewner.gpu.pairs import classify
from loewner.gpu.work import why_not

__all__ = ["Checker", "DeviceArray", "classify", "why_not"]
