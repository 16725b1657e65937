/* This file loads the compiled kernels. They are in files next to this library, one for each processor level. The file
   for the highest level that this machine supports is loaded; if it cannot be used, the next lower level is tried. */

#define _GNU_SOURCE
#include "internal.h"

#include "../levels.h"

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static _Thread_local char error_text[512];

loewner_status fail(loewner_status status, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(error_text, sizeof error_text, format, arguments);
    va_end(arguments);
    return status;
}

loewner_status no_memory(void)
{
    return fail(LOEWNER_NO_MEMORY, "an allocation failed");
}

loewner_status allocate(void *field, size_t size)
{
    void *memory = calloc(1, size);
    memcpy(field, &memory, sizeof memory);
    return memory == NULL ? no_memory() : LOEWNER_OK;
}

loewner_status enlarge(void *field, size_t size)
{
    void *memory;
    memcpy(&memory, field, sizeof memory);
    memory = realloc(memory, size);
    if (memory == NULL)
        return no_memory();
    memcpy(field, &memory, sizeof memory);
    return LOEWNER_OK;
}

const char *loewner_version(void)
{
    return LOEWNER_VERSION;
}

const char *loewner_error_text(void)
{
    return error_text;
}

const char *loewner_status_name(loewner_status status)
{
    static const char *const names[] = {
        "ok",        "bad argument", "bad file", "other version", "no kernels",
        "no memory", "unknown name", "not free", "no path",       "overflow",
    };
    size_t number = (size_t)status;
    return number < sizeof names / sizeof *names ? names[number] : "unknown status";
}

static Kernels found;
static char why_not[400];
static pthread_once_t once = PTHREAD_ONCE_INIT;

/* Load one file of kernels. If the file cannot be used, write the reason to `why_not` and return false. */
static int load(const char *path, const char *level)
{
    char expected[200];
    void *handle = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (handle == NULL) {
        snprintf(why_not, sizeof why_not, "%s", dlerror());
        return 0;
    }
    const char *build = dlsym(handle, "loewner_build");
    snprintf(expected, sizeof expected, "%s %s", SOURCES, level);
    int is_ours = build != NULL && strcmp(build, expected) == 0, is_whole = is_ours;
#define LOOK_UP(name)                                                                                    \
    *(void **)&found.name = dlsym(handle, "loewner_" #name);                                                           \
    is_whole = is_whole && found.name != NULL;
    ALL_KERNELS(LOOK_UP)
#undef LOOK_UP
    *(void **)&found.release = dlsym(handle, "loewner_release");
    is_whole = is_whole && found.release != NULL;
    if (is_whole && found.workspace_size(NULL, &found.settle_memory) == 0 &&
        found.memory_of_distances(NULL, &found.distance_memory) == 0) {
        found.level = level;
        return 1;
    }
    snprintf(why_not, sizeof why_not, "%.300s %s", path, is_ours ? "lacks a function" : "belongs to another version");
    dlclose(handle);
    return 0;
}

static void look(void)
{
    Dl_info own;
    char path[4096];
    snprintf(why_not, sizeof why_not, "this processor is older than those that loewner is built for");
    if (dladdr((void *)(intptr_t)loewner_level, &own) == 0 || own.dli_fname == NULL) {
        snprintf(why_not, sizeof why_not, "the folder of the library is unknown");
        return;
    }
    const char *slash = strrchr(own.dli_fname, '/');
    int folder = slash == NULL ? 0 : (int)(slash - own.dli_fname) + 1;
    for (const char *const *level = processor_levels(); *level != NULL; level++) {
        int length = snprintf(path, sizeof path, "%.*skernels-%s.so", folder, own.dli_fname, *level);
        if (length < (int)sizeof path && load(path, *level))
            return;
    }
}

const Kernels *kernels(void)
{
    pthread_once(&once, look);
    if (found.level != NULL)
        return &found;
    fail(LOEWNER_NO_KERNELS, "expected kernels-LEVEL.so beside libloewner, found none to use: %s", why_not);
    return NULL;
}

const char *loewner_level(void)
{
    const Kernels *known = kernels();
    return known == NULL ? NULL : known->level;
}

loewner_status call(Kernel kernel, const void *arguments, void *results)
{
    return kernel(arguments, results) == 0 ? LOEWNER_OK : no_memory();
}
