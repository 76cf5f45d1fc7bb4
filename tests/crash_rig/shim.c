/* Preloaded into a process under test: counts the calls that change files of one root and prefix and kills the process with
 * SIGKILL right after call number CRASH_AT. Without CRASH_AT it only lists them in CRASH_LOG, one a line. Reads what it is told
 * from the environment; changes nothing of what the calls do. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

static atomic_long calls;

static int is_ours(const char *path) {
    const char *root = getenv("CRASH_ROOT"), *prefix = getenv("CRASH_PREFIX");
    if (!path || !root || !prefix) return 0;
    if (strncmp(path, root, strlen(root)) == 0) return 1;
    const char *name = strrchr(path, '/');
    name = name ? name + 1 : path;
    return strncmp(name, prefix, strlen(prefix)) == 0;
}

static const char *path_of(int fd, char *buffer) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t len = readlink(link, buffer, PATH_MAX - 1);
    if (len < 0) return NULL;
    buffer[len] = 0;
    return buffer;
}

static void after(const char *call, const char *path) {
    if (!is_ours(path)) return;
    long number = atomic_fetch_add(&calls, 1) + 1;
    const char *log = getenv("CRASH_LOG"), *at = getenv("CRASH_AT");
    if (log) {
        char line[PATH_MAX + 64];
        int len = snprintf(line, sizeof line, "%s %s\n", call, path);
        int fd = (int)syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_APPEND | O_CREAT, 0600);
        if (fd >= 0) {
            syscall(SYS_write, fd, line, (size_t)len);
            syscall(SYS_close, fd);
        }
    }
    if (at && atol(at) == number) {
        kill(getpid(), SIGKILL);
        for (;;) pause();
    }
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

static mode_t mode_of(int flags, va_list list) {
    return flags & (O_CREAT | O_TMPFILE) ? va_arg(list, mode_t) : 0;
}

#define CHANGES(flags) ((flags) & (O_CREAT | O_TRUNC))

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        REAL(int, #name, const char *, int, ...); \
        va_list list; va_start(list, flags); mode_t mode = mode_of(flags, list); va_end(list); \
        int result = real(path, flags, mode); \
        if (CHANGES(flags) && result >= 0) after("open", path); \
        return result; \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(name) \
    int name(int directory, const char *path, int flags, ...) { \
        REAL(int, #name, int, const char *, int, ...); \
        va_list list; va_start(list, flags); mode_t mode = mode_of(flags, list); va_end(list); \
        int result = real(directory, path, flags, mode); \
        if (CHANGES(flags) && result >= 0) after("openat", path); \
        return result; \
    }
OPENAT(openat)
OPENAT(openat64)

int shm_open(const char *name, int flags, mode_t mode) {
    REAL(int, "shm_open", const char *, int, mode_t);
    int result = real(name, flags, mode);
    if (CHANGES(flags) && result >= 0) after("shm_open", name);
    return result;
}

#define ON_FILE(type, name, parameters, arguments, ...) \
    type name parameters { \
        REAL(type, #name, __VA_ARGS__); \
        char buffer[PATH_MAX]; \
        type result = real arguments; \
        after(#name, path_of(fd, buffer)); \
        return result; \
    }
ON_FILE(int, ftruncate, (int fd, off_t length), (fd, length), int, off_t)
ON_FILE(int, ftruncate64, (int fd, off64_t length), (fd, length), int, off64_t)
ON_FILE(int, fallocate, (int fd, int mode, off_t offset, off_t length), (fd, mode, offset, length), int, int, off_t, off_t)
ON_FILE(int, posix_fallocate, (int fd, off_t offset, off_t length), (fd, offset, length), int, off_t, off_t)
ON_FILE(int, fchmod, (int fd, mode_t mode), (fd, mode), int, mode_t)
ON_FILE(ssize_t, write, (int fd, const void *data, size_t length), (fd, data, length), int, const void *, size_t)

#define MMAP(name, offset_type) \
    void *name(void *address, size_t length, int protection, int flags, int fd, offset_type offset) { \
        REAL(void *, #name, void *, size_t, int, int, int, offset_type); \
        char buffer[PATH_MAX]; \
        void *result = real(address, length, protection, flags, fd, offset); \
        if (fd >= 0 && (flags & MAP_SHARED) && (protection & PROT_WRITE)) after("mmap", path_of(fd, buffer)); \
        return result; \
    }
MMAP(mmap, off_t)
MMAP(mmap64, off64_t)

#define ON_PATH(name, parameters, arguments, ...) \
    int name parameters { \
        REAL(int, #name, __VA_ARGS__); \
        int result = real arguments; \
        if (result == 0) after(#name, path); \
        return result; \
    }
ON_PATH(chmod, (const char *path, mode_t mode), (path, mode), const char *, mode_t)
ON_PATH(mkdir, (const char *path, mode_t mode), (path, mode), const char *, mode_t)
ON_PATH(unlink, (const char *path), (path), const char *)
ON_PATH(remove, (const char *path), (path), const char *)
ON_PATH(rmdir, (const char *path), (path), const char *)
ON_PATH(shm_unlink, (const char *path), (path), const char *)
ON_PATH(rename, (const char *path, const char *to), (path, to), const char *, const char *)
ON_PATH(unlinkat, (int directory, const char *path, int flags), (directory, path, flags), int, const char *, int)
