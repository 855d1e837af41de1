/* Runs a fuzz target once on each of some files, without libFuzzer: what the fuzzers begin with is a test of its own,
 * with any compiler.
 *
 *     fuzz_ply FILE...
 *
 * The target aborts where something is wrong; the file it was at is the last that was written.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerInitialize(int *argc, char ***argv) __attribute__((weak));

enum { MOST_BYTES = 1 << 20 };

/* A copy of its own size, so that a sanitizer sees what is read beyond the end. */
static int run_file(const char *path, uint8_t *room) {
    FILE *file = fopen(path, "rb");
    if (!file) return -1;
    size_t n = fread(room, 1, MOST_BYTES, file);
    int whole = !ferror(file) && n < MOST_BYTES;
    fclose(file);
    uint8_t *input = malloc(n ? n : 1);
    if (!whole || !input) return free(input), -1;
    for (size_t i = 0; i < n; i++) input[i] = room[i];
    LLVMFuzzerTestOneInput(input, n);
    free(input);
    return 0;
}

int main(int argc, char **argv) {
    uint8_t *room = malloc(MOST_BYTES);
    if (argc < 2 || !room) return fprintf(stderr, "no file to run on, or no memory\n"), 2;
    if (LLVMFuzzerInitialize) LLVMFuzzerInitialize(&argc, &argv);
    for (int i = 1; i < argc; i++) {
        fprintf(stderr, "[ RUN      ] %s\n", argv[i]);
        if (run_file(argv[i], room)) return fprintf(stderr, "%s can't be read, or is too long\n", argv[i]), 1;
        fprintf(stderr, "[       OK ] %s\n", argv[i]);
    }
    free(room);
    return 0;
}
