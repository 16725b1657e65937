"""Compiled kernels: they use only scalars and arrays, and import no other module of `loewner`."""

from pathlib import Path

# In a wheel, an archive holds the modules that only Numba reads (`_sources.LOOSE` lists the other modules), because
# installers would compile loose modules to byte code, which is larger than the sources.
__path__.append(str(Path(__file__).with_name("sources.zip")))
