/* Loaded before the C library into the real daemon and controller: lets one named thread panic, vanish or hang, and shifts the wall clock.
 *
 * In: 40 bytes shared with the test: name of the thread (16), CLOCK_BOOTTIME of the fault (u64, out), shift of the wall clock in seconds
 * (i64), what the thread is to do (i64): 0 panic, 1 vanish, 2 hang. A thread panics because the standard library takes a clock or a
 * sleep that fails for a broken system; it does so once. Never touches CLOCK_BOOTTIME, which the program reads without this library.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

struct shared {
    volatile char name[16];
    volatile uint64_t fired_ns;
    volatile int64_t wall_shift_s;
    volatile int64_t fate;
};

static struct shared *shared;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("NOCTULE_SHIM");
    int file = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    if (file < 0) return;
    void *mapped = mmap(NULL, sizeof(struct shared), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (mapped != MAP_FAILED) shared = mapped;
    close(file);
}

static int meant(void) {
    char name[16] = {0};
    struct timespec now;
    if (!shared || !shared->name[0]) return 0;
    prctl(PR_GET_NAME, name);
    if (strncmp(name, (const char *)shared->name, 15) != 0) return 0;
    shared->name[0] = 0;
    syscall(SYS_clock_gettime, CLOCK_BOOTTIME, &now);
    shared->fired_ns = (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
    if (shared->fate == 1) syscall(SYS_exit, 0);
    while (shared->fate == 2) pause();
    return 1;
}

int clock_gettime(clockid_t clock, struct timespec *time) {
    if (clock == CLOCK_MONOTONIC && meant()) {
        errno = EINVAL;
        return -1;
    }
    int result = (int)syscall(SYS_clock_gettime, clock, time);
    if (result == 0 && clock == CLOCK_REALTIME && shared) time->tv_sec += shared->wall_shift_s;
    return result;
}

int nanosleep(const struct timespec *time, struct timespec *left) {
    if (meant()) {
        errno = EINVAL;
        return -1;
    }
    return (int)syscall(SYS_nanosleep, time, left);
}

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *time, struct timespec *left) {
    if (meant()) {
        errno = EINVAL;
        return EINVAL;
    }
    return syscall(SYS_clock_nanosleep, clock, flags, time, left) == 0 ? 0 : errno;
}
