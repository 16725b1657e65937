/* Functions for libraries, for memory that begins at a cache line, and for memory of threads. Windows and POSIX have
   different names for these functions. The part for Windows is untested. */

#ifndef LOEWNER_SYSTEM_H
#define LOEWNER_SYSTEM_H

#include <stdlib.h>

#ifndef _WIN32

#include <dlfcn.h>
#include <pthread.h>
#define EXPORTED

#else

#define WIN32_LEAN_AND_MEAN
#include <windows.h>

#include <malloc.h>

#define EXPORTED __declspec(dllexport)

/* Files with this header free only memory that was allocated in this way. */
#define aligned_alloc(alignment, size) _aligned_malloc(size, alignment)
#define free _aligned_free

enum { RTLD_NOW, RTLD_LOCAL };

static inline void *dlopen(const char *path, int flags)
{
    wchar_t wide[MAX_PATH * 8];
    (void)flags;
    return MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, MAX_PATH * 8) ? LoadLibraryW(wide) : NULL;
}

static inline const char *dlerror(void)
{
    return "the library cannot be opened";
}

static inline void *dlsym(void *handle, const char *name)
{
    return (void *)GetProcAddress(handle, name);
}

static inline void dlclose(void *handle)
{
    FreeLibrary(handle);
}

typedef DWORD pthread_key_t;

static inline int pthread_key_create(pthread_key_t *key, void (*at_end)(void *))
{
    *key = FlsAlloc(at_end);
    return *key == FLS_OUT_OF_INDEXES;
}

static inline void *pthread_getspecific(pthread_key_t key)
{
    return FlsGetValue(key);
}

static inline int pthread_setspecific(pthread_key_t key, void *value)
{
    return !FlsSetValue(key, value);
}

#endif

#endif
