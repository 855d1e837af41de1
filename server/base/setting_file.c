/* Files that settings name.
 *
 * O_NONBLOCK, because open(2) of a FIFO waits otherwise; what was opened is looked at, not its name, which may be
 * another file's a moment later.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/setting_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum status setting_file_open(const char *setting, const char *path, FILE **file, struct error *error) {
    struct stat facts;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
    if (fd < 0 || fstat(fd, &facts) != 0) {
        error_set(error, STATUS_IO, setting, "can't read %.200s: %s", path, strerror(errno));
    } else if (!S_ISREG(facts.st_mode)) {
        error_set(error, STATUS_BAD_PARAMETER, setting, "%.200s is not a regular file", path);
    } else if ((*file = fdopen(fd, "r"))) {
        return STATUS_OK;
    } else {
        error_set(error, STATUS_NO_MEMORY, setting, "no memory");
    }
    if (fd >= 0) close(fd);
    return error->code;
}

enum status setting_file_read(const char *setting, const char *path, char **text, size_t *bytes, struct error *error) {
    FILE *file;
    enum status status = setting_file_open(setting, path, &file, error);
    if (status != STATUS_OK) return status;
    char *read = malloc(SETTING_FILE_MAX_BYTES + 1);
    size_t count = 0;
    if (!read)
        status = error_set(error, STATUS_NO_MEMORY, setting, "no memory");
    else if ((count = fread(read, 1, SETTING_FILE_MAX_BYTES + 1, file)) > SETTING_FILE_MAX_BYTES)
        status = error_set(error, STATUS_BAD_PARAMETER, setting, "%.200s is longer than 1 MiB", path);
    else if (ferror(file))
        status = error_set(error, STATUS_IO, setting, "can't read %.200s", path);
    fclose(file);
    if (status == STATUS_OK) {
        read[count] = 0;
        *text = read;
        *bytes = count;
    } else {
        free(read);
    }
    return status;
}
