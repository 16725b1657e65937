"""Check pairs and configurations by the thousand on an NVIDIA GPU. Experimental: it has not run on hardware yet.

The certificate's formulas run there in single precision, and give proofs as on the CPU. Pairs that single precision
leaves undecided go to the CPU, so the answers are the same as the CPU's. Only the driver of the GPU is needed; it is
loaded when a function here is first called.
"""

from loewner.gpu.arrays import DeviceArray
from loewner.gpu.configurations import Checker
from loewner.gpu.pairs import classify
from loewner.gpu.work import why_not

__all__ = ["Checker", "DeviceArray", "classify", "why_not"]
