/* The figures come from /proc and from a listing of the folder, some times a second: a process that takes too much is
 * ended a moment later rather than hindered.  RLIMIT_NPROC hinders it where runner/confine.c can set it; length of a
 * file, memory, processor time and descriptors have limits of the kernel's.
 *
 * Nothing that a process leaves is believed: names, number and kind of its files are compared with what was asked for.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/runner/footprint.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { THREADS_BESIDE = 16, FILES_BESIDE = 8, TEXT_BYTES = 1024 };

struct footprint footprint_most(const struct params *params, uint64_t threads, uint64_t written_bytes) {
    /* Each file has a temporary name beside those that are there. */
    return (struct footprint){.threads = 2 * threads + THREADS_BESIDE,
                              .files = 2 * params_file_count(params) + FILES_BESIDE,
                              .written_bytes = written_bytes};
}

struct footprint footprint_most_of_task(const struct params *params, uint64_t threads, uint64_t written_bytes) {
    struct footprint most = footprint_most(params, threads, written_bytes);
    most.files += 2 * (uint64_t)JOB_MAX_TILES; /* or parts of a tileset's points, eight for each level of a tree */
    return most;
}

/* ------------------------------------------------------------------------------------------------ looking */

/* A short file of /proc as text; "" where it can't be read. */
static const char *read_text(pid_t pid, const char *name, char text[TEXT_BYTES]) {
    char path[64];
    snprintf(path, sizeof path, "/proc/%d/%s", (int)pid, name);
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    ssize_t n = fd >= 0 ? read(fd, text, TEXT_BYTES - 1) : 0;
    if (fd >= 0) close(fd);
    text[n > 0 ? n : 0] = 0;
    return text;
}

/* The number after "name: ", 0 where there is none. */
static uint64_t number_after(const char *text, const char *name) {
    const char *at = strstr(text, name);
    return at ? strtoull(at + strlen(name), NULL, 10) : 0;
}

/* The 20th field of stat; the second, the program's name, may hold anything up to the last parenthesis. */
static uint64_t threads_of(pid_t pid) {
    char text[TEXT_BYTES];
    const char *at = strrchr(read_text(pid, "stat", text), ')');
    for (int field = 2; at && field < 20; field++) at = strchr(at + 1, ' ');
    return at ? strtoull(at, NULL, 10) : 0;
}

static bool is_own(const char *name) { return strcmp(name, ".") == 0 || strcmp(name, "..") == 0; }

static DIR *open_listing(const char *folder) {
    int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
    DIR *listing = fd >= 0 ? fdopendir(fd) : NULL;
    if (fd >= 0 && !listing) close(fd);
    return listing;
}

static void count_files(const char *folder, uint64_t most, struct footprint *found) {
    DIR *listing = open_listing(folder);
    uint64_t blocks_bytes = 0;
    for (struct dirent *entry; listing && found->files <= most && (entry = readdir(listing));) {
        struct stat facts;
        if (is_own(entry->d_name)) continue;
        found->files++;
        if (fstatat(dirfd(listing), entry->d_name, &facts, AT_SYMLINK_NOFOLLOW) == 0)
            blocks_bytes += (uint64_t)facts.st_blocks * 512;
    }
    if (listing) closedir(listing);
    if (blocks_bytes > found->written_bytes) found->written_bytes = blocks_bytes;
}

struct footprint footprint_of(pid_t pid, const char *folder, uint64_t files_most) {
    char text[TEXT_BYTES];
    struct footprint found = {.threads = threads_of(pid)};
    read_text(pid, "io", text);
    uint64_t by_calls = number_after(text, "wchar: "), to_disk = number_after(text, "\nwrite_bytes: ");
    found.written_bytes = by_calls > to_disk ? by_calls : to_disk; /* what is mapped is in the second alone */
    count_files(folder, files_most, &found);
    return found;
}

/* ------------------------------------------------------------------------------------------------ checking */

/* Names are shown to clients as far as they are plain. */
static enum status not_believed(struct error *error, const char *name, const char *what) {
    char shown[64];
    size_t n = 0;
    for (; name[n] && n + 1 < sizeof shown; n++) shown[n] = name[n] > 0x20 && name[n] < 0x7f ? name[n] : '?';
    shown[n] = 0;
    return error_set(error, STATUS_ENGINE, "outputs", "the job's process said that it was done, but %s %s", shown,
                     what);
}

static bool output_is_wanted(const struct params *params, const char *name) {
    char wanted[PARAMS_FILE_BYTES];
    for (unsigned i = 0; params_file(params, i, wanted); i++)
        if (strcmp(wanted, name) == 0) return true;
    return false;
}

static enum status check_file(int folder_fd, const char *name, struct error *error) {
    struct stat facts;
    if (fstatat(folder_fd, name, &facts, AT_SYMLINK_NOFOLLOW) != 0) return not_believed(error, name, "isn't there");
    if (!S_ISREG(facts.st_mode)) return not_believed(error, name, "is no file");
    if (facts.st_nlink != 1) return not_believed(error, name, "has another name");
    if (facts.st_size == 0) return not_believed(error, name, "is empty");
    bool ours = facts.st_uid == geteuid() || fchownat(folder_fd, name, geteuid(), getegid(), AT_SYMLINK_NOFOLLOW) == 0;
    return ours ? STATUS_OK : not_believed(error, name, "can't be taken over");
}

static bool take_over(int folder_fd) {
    struct stat facts;
    return fstat(folder_fd, &facts) == 0 && (facts.st_uid == geteuid() || fchown(folder_fd, geteuid(), getegid()) == 0);
}

enum status footprint_check(const char *folder, const struct params *params, struct error *error) {
    char wanted[PARAMS_FILE_BYTES];
    DIR *listing = open_listing(folder);
    enum status status = STATUS_OK;
    if (!listing) return error_set(error, STATUS_IO, "outputs", "can't list the outputs: %s", strerror(errno));
    if (!take_over(dirfd(listing)))
        status = error_set(error, STATUS_IO, "outputs", "can't take over the outputs: %s", strerror(errno));
    for (unsigned i = 0; status == STATUS_OK && params_file(params, i, wanted); i++)
        status = check_file(dirfd(listing), wanted, error);
    for (struct dirent *entry; status == STATUS_OK && (entry = readdir(listing));)
        if (!is_own(entry->d_name) && !output_is_wanted(params, entry->d_name))
            status = not_believed(error, entry->d_name, "was not asked for");
    closedir(listing);
    return status;
}

/* "NAME.N" without a zero before it; -1: it isn't so. */
static int64_t number_of(const char *file, const char *name) {
    char again[64];
    size_t length = strlen(name);
    if (strncmp(file, name, length) != 0 || file[length] != '.') return -1;
    long long n = strtoll(file + length + 1, NULL, 10);
    snprintf(again, sizeof again, "%s.%lld", name, n);
    return n >= 0 && strcmp(again, file) == 0 ? n : -1;
}

enum status footprint_check_task(const char *folder, int64_t task, bool may_have_gone, int64_t *tiles,
                                 struct error *error) {
    DIR *listing = open_listing(folder);
    enum status status = STATUS_OK;
    bool is_plan = task == JOB_TASK_PLAN;
    int64_t others = 0, parts = 0, most = -1;
    if (!listing) return error_set(error, STATUS_IO, "outputs", "can't list what was made: %s", strerror(errno));
    if (!take_over(dirfd(listing)))
        status = error_set(error, STATUS_IO, "outputs", "can't take over what was made: %s", strerror(errno));
    for (struct dirent *entry; status == STATUS_OK && (entry = readdir(listing));) {
        const char *name = entry->d_name;
        if (is_own(name)) continue;
        int64_t part = number_of(name, is_plan ? "points" : "left");
        bool other = is_plan && (strcmp(name, "plan") == 0 || strcmp(name, "around") == 0);
        if (!is_plan && may_have_gone && number_of(name, "gone") == task - 1) {
            status = check_file(dirfd(listing), name, error);
            continue;
        }
        if (!other && (part < 0 || part >= JOB_MAX_TILES || (!is_plan && part != task - 1)))
            status = not_believed(error, name, "was not asked for");
        else
            status = check_file(dirfd(listing), name, error);
        others += other;
        parts += !other;
        if (part > most) most = part;
    }
    closedir(listing);
    bool all = is_plan ? others == 2 && parts == most + 1 && parts > 0 : parts == 1;
    if (status == STATUS_OK && !all) status = not_believed(error, "a file", "isn't there");
    if (status == STATUS_OK && is_plan) *tiles = parts;
    return status;
}
