/* Reads noctule's energyscapes and commands in C and C++. Link with libnoctule_c.so:
 *
 *     cargo build --release --example noctule_c
 *     cc -Iexamples/c examples/c/energyscape_peak.c -Ltarget/release/examples -lnoctule_c -o energyscape_peak
 *
 * A reader belongs to one thread at a time. Nothing here moves the robot. */
#ifndef NOCTULE_READER_H
#define NOCTULE_READER_H

#include "noctule_types.h" /* noctule topics --c-header */

#ifdef __cplusplus
extern "C" {
#endif

typedef struct noctule_reader noctule_reader;

/* Opens the energyscapes of `sensor` (NULL: the first) where the configuration file says (NULL: the built-in configuration). noctule may start
 * later. NULL when it fails: see noctule_error(). */
noctule_reader *noctule_open(const char *config, const char *sensor);

/* Waits for an energyscape newer than the last one, the newest wins. 1: *header and *cells point at a copy that is valid until the next call;
 * cells[i * header->range_count + k] is direction i, range k, linear amplitude. 0: none in time. -1: see noctule_error(). */
int noctule_next(noctule_reader *reader, uint32_t timeout_ms, const struct noctule_energyscape_header_v1 **header,
                 const float **cells);

/* Copies the newest command since the last call. 1: there was one, 0: none, -1: see noctule_error(). Judge it by its t_monotonic_ns. */
int noctule_newest_command(noctule_reader *reader, struct noctule_velocity_command_v1 *command);

/* Nanoseconds of CLOCK_BOOTTIME, the clock of all t_..._ns. */
uint64_t noctule_now_ns(void);

/* Why the last call of this thread failed. */
const char *noctule_error(void);

void noctule_close(noctule_reader *reader);

#ifdef __cplusplus
}
#endif
#endif
