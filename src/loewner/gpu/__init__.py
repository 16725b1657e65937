"""Check thousands of pairs or configurations on an NVIDIA GPU. Experimental: not yet run on hardware.

The certificate's formulas run there in single precision and give proofs, as on the CPU. The CPU decides pairs that
single precision leaves undecided, so the answers are the same as on the CPU alone. Only the driver of the GPU is
needed; it is loaded when a function here is first called.
"""

from loewner.gpu.arrays import DeviceArray
from loewner.gpu.configurations import Checker
from loewner.gpu.pairs import classify
from loewner.gpu.work import why_not

__all__ = ["Checker", "DeviceArray", "classify", "why_not"]
