/* A folder can be opened, and reading it fails: that is told as of a file that isn't there.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/input.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/io/join.h"
#include "core/io/read.h"

enum status command_input_open(const char *path, int *input, struct error *error) {
    bool standard = strcmp(path, "-") == 0;
    int fd = standard ? STDIN_FILENO : open(path, O_RDONLY | O_CLOEXEC), failure = errno;
    struct stat about;
    bool folder = fd >= 0 && fstat(fd, &about) == 0 && S_ISDIR(about.st_mode);
    *input = -1;
    if (folder && !standard) close(fd);
    if (folder) return error_set(error, STATUS_IO, "read", "%s is a folder; use the names of its files", path);
    if (fd < 0) return error_set(error, STATUS_IO, "read", "can't open %s: %s", path, strerror(failure));
    *input = fd;
    return STATUS_OK;
}

void command_input_close(int input) {
    if (input > STDIN_FILENO) close(input);
}

/* ------------------------------------------------------------------------------------------------ several */

/* As many descriptors as the system allows, where files are many. */
static void allow_descriptors(size_t count) {
    struct rlimit limit;
    enum { OTHERS = 64 };
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0 || limit.rlim_cur > count + OTHERS) return;
    limit.rlim_cur = limit.rlim_max;
    (void)setrlimit(RLIMIT_NOFILE, &limit); /* else opening says so */
}

enum status command_inputs_open(struct command_inputs *inputs, const char *const *name, size_t count,
                                struct error *error) {
    enum status status = STATUS_OK;
    struct stat about;
    inputs->count = count, inputs->name = name;
    inputs->fd = alloc_array(count, sizeof *inputs->fd);
    inputs->source = alloc_array(count, sizeof *inputs->source);
    for (size_t i = 0; inputs->fd && i < count; i++) inputs->fd[i] = -1;
    if (!inputs->fd || !inputs->source) return error_set(error, STATUS_NO_MEMORY, "read", "no memory for names");
    if (count > 1) allow_descriptors(count);
    for (size_t i = 0; i < count && !status; i++) {
        status = command_input_open(name[i], &inputs->fd[i], error);
        if (status) inputs->failed = name[i];
        if (!status && fstat(inputs->fd[i], &about) == 0 && S_ISREG(about.st_mode))
            inputs->source[inputs->source_count++] = (struct file_out_source){about.st_dev, about.st_ino};
    }
    return status;
}

/* The progress of one file within that of all. */
struct part {
    const struct progress *whole;
    double before, of;
};

static int tick_part(void *ctx, const char *stage, double fraction) {
    const struct part *part = ctx;
    return progress_tick(part->whole, stage, (part->before + fraction) / part->of);
}

enum status command_inputs_read(struct command_inputs *inputs, const struct cloud_limits *limits,
                                const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct cloud_join join = {0};
    struct cloud_limits each = *limits;
    enum status status = STATUS_OK;
    each.columns_if_text = each.columns_if_text || inputs->count > 1;
    for (size_t i = 0; i < inputs->count && !status; i++) {
        struct cloud next = {0};
        struct part part = {progress, (double)i, (double)inputs->count};
        status = cloud_read(inputs->fd[i], &each, &(struct progress){tick_part, &part}, &next, error);
        if (!status) status = cloud_join_add(&join, &next, inputs->name[i], error);
        if (status) inputs->failed = inputs->name[i];
    }
    if (!status) return cloud_join_end(&join, cloud, error);
    cloud_join_done(&join);
    return status;
}

uint64_t command_inputs_bytes(const struct command_inputs *inputs) {
    struct stat about;
    uint64_t bytes = 0;
    for (size_t i = 0; inputs->fd && i < inputs->count; i++)
        if (fstat(inputs->fd[i], &about) == 0 && S_ISREG(about.st_mode)) bytes += (uint64_t)about.st_size;
    return bytes;
}

void command_inputs_done(struct command_inputs *inputs) {
    for (size_t i = 0; inputs->fd && i < inputs->count; i++) command_input_close(inputs->fd[i]);
    free(inputs->fd), free(inputs->source);
    *inputs = (struct command_inputs){0};
}
