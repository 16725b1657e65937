"""Pairs and configurations by the thousand on an NVIDIA GPU. Experimental: it has not run on hardware yet.

The certificate's own formulas run there in single precision, and are proofs as on the CPU. What single precision cannot
tell goes to the CPU, so that answers are the CPU's. The driver of the GPU is all that is needed; it is loaded when a
function here is called, and not before.
"""

from loewner.gpu.arrays import DeviceArray
from loewner.gpu.configurations import Checker
from loewner.gpu.pairs import classify
from loewner.gpu.work import why_not

__all__ = ["Checker", "DeviceArray", "classify", "why_not"]
