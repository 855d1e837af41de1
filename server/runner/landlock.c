/* Landlock, by its three system calls: rules for files that a process puts on itself and never gets rid of.
 *
 * Structures and rights are those of the kernel's documentation up to version 6 (userspace-api/landlock), written down
 * here because the headers of older systems lack the newer ones.  A right that an older kernel doesn't know is left
 * out.
 *
 * The input comes as an open descriptor.  What else may be read is what the loader and the libraries open: shared
 * libraries, the loader's cache, the number of processors, random numbers.  Whether a file exists can still be found
 * out; Landlock has no right for it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/runner/landlock.h"

#include <fcntl.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "core/base/fault.h"

enum { CREATE_RULESET = 444, ADD_RULE = 445, RESTRICT_SELF = 446 }; /* the same on all processors */
enum { GET_VERSION = 1, PATH_BENEATH = 1, FILES_ALONE = 2 };

struct ruleset {
    uint64_t files, network, scopes;
};

struct path_rule {
    uint64_t rights;
    int32_t fd;
} __attribute__((packed));

/* Rights on files, one bit each. */
#define EXECUTE (UINT64_C(1) << 0)
#define WRITE_FILE (UINT64_C(1) << 1)
#define READ_FILE (UINT64_C(1) << 2)
#define READ_FOLDER (UINT64_C(1) << 3)
#define REMOVE_FILE (UINT64_C(1) << 5)
#define MAKE_FILE (UINT64_C(1) << 8)
#define TRUNCATE (UINT64_C(1) << 14)
#define OF_A_FILE (EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE)

/* For tests a newer kernel passes as Debian 12's, which has files alone, or as one without. */
int landlock_version(void) {
    long version = fault_at("landlock") ? 0 : syscall(CREATE_RULESET, NULL, 0, GET_VERSION);
    if (version > FILES_ALONE && fault_at("landlock-newer")) version = FILES_ALONE;
    return version > 0 ? (int)version : 0;
}

/* A path that isn't there needs no rule.  Whether it is a folder is found by opening it rather than by fstat, which is
 * not always a system call alone: a preloaded library that sets the clock takes a lock in it, which another thread may
 * have held when this process was forked. */
static bool allow(int ruleset_fd, const char *path, uint64_t rights) {
    struct path_rule rule = {.rights = rights, .fd = open(path, O_PATH | O_CLOEXEC | O_DIRECTORY)};
    if (rule.fd < 0) {
        rule.fd = open(path, O_PATH | O_CLOEXEC);
        rule.rights &= OF_A_FILE;
    }
    if (rule.fd < 0) return true;
    bool ok = syscall(ADD_RULE, ruleset_fd, PATH_BENEATH, &rule, 0) == 0;
    close(rule.fd);
    return ok;
}

bool landlock_apply(int version, const char *program, const char *folder) {
    static const char *const libraries[] = {"/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib"};
    static const char *const readable[] = {"/etc/ld.so.cache", "/etc/ld.so.preload", "/sys/devices/system/cpu",
                                           "/dev/urandom", "/dev/null"};
    int bits = 13 + (version >= 2) + (version >= 3) + (version >= 5); /* rights that each version has added */
    uint64_t known = (UINT64_C(1) << bits) - 1;
    struct ruleset ruleset = {known, version >= 4 ? 3 : 0, version >= 6 ? 3 : 0};
    size_t bytes = version >= 6   ? sizeof ruleset
                   : version >= 4 ? offsetof(struct ruleset, scopes)
                                  : offsetof(struct ruleset, network);
    int fd = (int)syscall(CREATE_RULESET, &ruleset, bytes, 0);
    if (fd < 0) return false;
    bool ok = allow(fd, program, EXECUTE | READ_FILE) &&
              allow(fd, folder, (READ_FILE | WRITE_FILE | READ_FOLDER | REMOVE_FILE | MAKE_FILE | TRUNCATE) & known);
    for (size_t i = 0; ok && i < sizeof libraries / sizeof *libraries; i++)
        ok = allow(fd, libraries[i], READ_FILE | READ_FOLDER | EXECUTE);
    for (size_t i = 0; ok && i < sizeof readable / sizeof *readable; i++)
        ok = allow(fd, readable[i], READ_FILE | READ_FOLDER);
    ok = ok && syscall(RESTRICT_SELF, fd, 0) == 0;
    close(fd);
    return ok;
}
