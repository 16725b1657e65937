"""Check millions of pairs, configurations or motions on an NVIDIA GPU.

The GPU evaluates the formulas of the proofs in single precision, with bounds on the errors. The CPU decides the cases
that single precision leaves undecided, so the answers are the same as on the CPU alone. Only the GPU's driver is
needed; the driver is loaded when a function here is first called. Users call `configurations` and `pairs`. `motions`
halves intervals, `tiles` and `tables` hold memory and the robot on the GPU, `work` lists work for the CPU, `arrays`
reads other libraries' arrays, `driver` calls the driver, and `_ptx` generates the code.
"""

from loewner.gpu.arrays import DeviceArray
from loewner.gpu.configurations import Checker
from loewner.gpu.pairs import classify
from loewner.gpu.work import why_not

__all__ = ["Checker", "DeviceArray", "classify", "why_not"]
