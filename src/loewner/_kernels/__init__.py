"""Compiled kernels: they use only scalars and arrays, and import no other module of `loewner`."""

from pathlib import Path

# In a wheel, the modules that only Numba reads are in an archive; `_sources.LOOSE` lists the other modules. Installers
# would compile loose modules to byte code, which is larger than the sources.
__path__.append(str(Path(__file__).with_name("sources.zip")))
