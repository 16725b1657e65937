"""Compiled kernels: they use only scalars and arrays, and import no other module of `loewner`."""

from pathlib import Path

# In a wheel, the modules that only Numba reads are in an archive. All other modules, which `_sources.LOOSE` lists, are
# loose files. If the archived modules were loose files, too, installers would compile them to byte code, which takes
# more space than the sources.
__path__.append(str(Path(__file__).with_name("sources.zip")))
