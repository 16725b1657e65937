"""Compiled kernels: scalars and arrays only; imports no other module of `loewner`."""

from pathlib import Path

# A wheel has the modules that only Numba reads in an archive (`_sources.LOOSE` lists the others): installers make byte
# code of loose ones, which takes more room than the sources.
__path__.append(str(Path(__file__).with_name("sources.zip")))
