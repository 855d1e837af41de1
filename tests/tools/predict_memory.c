/* predict_memory FILE [name=value ...]: the bytes that a job is predicted to take.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "core/params.h"
#include "core/pipeline/memory.h"

static int complain(const char *what) {
    fprintf(stderr, "predict_memory: %s\n", what);
    return 1;
}

static enum status set(struct params *params, char *setting) {
    char *equals = strchr(setting, '=');
    if (!equals) return STATUS_BAD_PARAMETER;
    *equals = '\0';
    return params_set(params, setting, equals + 1, NULL);
}

int main(int argc, char **argv) {
    static unsigned char first[1 << 16];
    struct params params;
    struct memory_job job;
    struct stat stat;
    if (argc < 2) return complain("predict_memory FILE [--most] [name=value ...]");
    FILE *file = fopen(argv[1], "rb");
    if (!file || fstat(fileno(file), &stat)) return complain("can't read the file");
    size_t n = fread(first, 1, sizeof first, file);
    fclose(file);
    params_defaults(&params);
    bool most = argc > 2 && strcmp(argv[2], "--most") == 0;
    for (int i = most ? 3 : 2; i < argc; i++)
        if (set(&params, argv[i])) return complain("bad setting");
    if (params_resolve(&params, NULL)) return complain("bad settings");
    if (memory_job_of(first, n, (uint64_t)stat.st_size, &job)) return complain("no header that says what comes");
    printf("%" PRIu64 "\n", most ? memory_predict_most(&job, &params) : memory_predict(&job, &params));
    return 0;
}
