/* A folder can be opened, and reading it fails: that is told as of a file that isn't there.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/input.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum status worker_input_open(const char *path, int *input, struct error *error) {
    bool standard = strcmp(path, "-") == 0;
    int fd = standard ? STDIN_FILENO : open(path, O_RDONLY | O_CLOEXEC), failure = errno;
    struct stat about;
    bool folder = fd >= 0 && fstat(fd, &about) == 0 && S_ISDIR(about.st_mode);
    *input = -1;
    if (folder && !standard) close(fd);
    if (fd < 0 || folder)
        return error_set(error, STATUS_IO, "read", "can't open %s: %s", path, strerror(folder ? EISDIR : failure));
    *input = fd;
    return STATUS_OK;
}

void worker_input_close(int input) {
    if (input > STDIN_FILENO) close(input);
}
