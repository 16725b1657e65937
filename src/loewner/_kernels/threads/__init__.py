"""The work of one GPU thread, as functions of the thread's number.

`loewner.gpu._ptx` wraps each function that it lists in a kernel, which calls the function with the number of the
thread. All arguments are int64: numbers, and addresses of memory that begins at a multiple of sixteen bytes. Arrays are
float32, int32 and int8; no number is in double precision. The tests run the same functions in a loop on the CPU.
"""
