/* VmHWM of /proc/PID/status, in kibibytes: the high-water mark of the address space (man 5 proc).  Where /proc can't be
 * read, as by a confined job, getrusage is asked for this process.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/process_memory.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

uint64_t process_peak_bytes(int pid) {
    char path[64] = "/proc/self/status", text[4096];
    if (pid) snprintf(path, sizeof path, "/proc/%d/status", pid);
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    ssize_t n = fd >= 0 ? read(fd, text, sizeof text - 1) : 0;
    if (fd >= 0) close(fd);
    text[n > 0 ? n : 0] = 0;
    const char *at = strstr(text, "\nVmHWM:");
    if (at) return strtoull(at + strlen("\nVmHWM:"), NULL, 10) * 1024;
    struct rusage usage = {0};
    if (pid || getrusage(RUSAGE_SELF, &usage) != 0) return 0;
    return (uint64_t)usage.ru_maxrss * 1024;
}
