"""The kernels for Python: from the native library, or compiled on this machine.

`entries` lists the kernels with their signatures, `library` chooses the file for the processor, and `singles` calls the
extension for one pair, configuration or motion.
"""
