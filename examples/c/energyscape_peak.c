/* Follows the strongest echo of one sensor. One line a ping, as the Python and Rust examples print it.
 * Usage: energyscape_peak CONFIG SENSOR COUNT TIMEOUT_MS */
#include "noctule_reader.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv) {
    if (argc != 5) {
        fprintf(stderr, "usage: %s CONFIG SENSOR COUNT TIMEOUT_MS\n", argv[0]);
        return 2;
    }
    long count = strtol(argv[3], NULL, 10);
    uint32_t timeout_ms = (uint32_t)strtoul(argv[4], NULL, 10);
    noctule_reader *reader = noctule_open(argv[1], argv[2]);
    if (reader == NULL) {
        fprintf(stderr, "%s\n", noctule_error());
        return 69;
    }
    uint64_t before = 0;
    for (long printed = 0; printed < count; printed++) {
        const struct noctule_energyscape_header_v1 *header;
        const float *cells;
        int got = noctule_next(reader, timeout_ms, &header, &cells);
        if (got <= 0) {
            fprintf(stderr, "%s\n", got == 0 ? "no ping in time" : noctule_error());
            noctule_close(reader);
            return 69;
        }
        size_t strongest = 0;
        for (size_t cell = 0; cell < (size_t)header->direction_count * header->range_count; cell++) {
            if (cells[cell] > cells[strongest]) {
                strongest = cell;
            }
        }
        double bearing_rad = header->direction_first_rad + (double)(strongest / header->range_count) * header->direction_step_rad;
        double range_m = header->range_first_m + (double)(strongest % header->range_count) * header->range_step_m;
        unsigned long long lost = before == 0 || header->sequence <= before ? 0 : header->sequence - before - 1;
        printf("range_m=%.4f bearing_deg=%.3f value=%.6f sequence=%llu t_monotonic_ns=%llu age_ms=%.1f lost=%llu\n", range_m,
               bearing_rad * 180.0 / acos(-1.0), (double)cells[strongest], (unsigned long long)header->sequence,
               (unsigned long long)header->t_monotonic_ns, (double)(noctule_now_ns() - header->t_monotonic_ns) / 1e6, lost);
        before = header->sequence;
    }
    noctule_close(reader);
    return 0;
}
