/* A job's process is confined between fork and exec, by the service and not by itself: so it holds from the program's
 * first instruction, for the loader too, and for any program that `worker` names.
 *
 *     limits              address space, processor time, length of a file, descriptors, no core file
 *     no new privileges   no set-user-id program gives any; no capabilities either, where the service has them
 *     no network          a network namespace with nothing in it (a user namespace with it where that takes no rights)
 *     Landlock            files: daemon_landlock.c
 *     seccomp             system calls: daemon_seccomp.c
 *
 * In this order, because the last would forbid what those before it do.  A kernel without one of the last three is no
 * reason not to start: the log says what holds, and whether that is enough is for the operator to say.  But what was
 * there at the start must hold for each job, or the job doesn't run.
 *
 * A program built with sanitizers can't be confined so: they reserve terabytes, start processes and read /proc.  That
 * is what worker-sandbox=off is for; limits stay.
 *
 * Missing on purpose: a user of its own, a mount namespace, a control group.  They take rights that the service needn't
 * have; where it runs as a unit or a container, its manager gives them to all of it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/daemon_confine.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/capability.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "server/daemon_landlock.h"
#include "server/daemon_seccomp.h"

#define ADDRESSABLE ((rlim_t)1 << 47)

enum { MAX_FILES = 64, NICE = 5, CPU_GRACE_S = 5 };

struct confinement {
    const char *program;
    struct seccomp_filter *filter; /* NULL: none */
    int landlock;                  /* its version; 0: none */
    bool no_network;
};

static char *const no_environment[] = {NULL};

/* ------------------------------------------------------------------------------------------------ limits */

static void limit(int resource, rlim_t soft, rlim_t hard) {
    struct rlimit limits = {soft, hard};
    setrlimit(resource, &limits);
}

/* SIGXCPU at the limit of time, SIGKILL a little later.  More memory than a process can address is no limit, and isn't
 * set as one: a program under ThreadSanitizer would refuse to run. */
static void set_limits(const struct confine_limits *limits) {
    rlim_t cpu_s = (rlim_t)((limits->cpu_ms + 999) / 1000), memory = (rlim_t)limits->memory_bytes;
    limit(RLIMIT_CORE, 0, 0);
    limit(RLIMIT_NOFILE, MAX_FILES, MAX_FILES);
    limit(RLIMIT_CPU, cpu_s, cpu_s + CPU_GRACE_S);
    limit(RLIMIT_FSIZE, (rlim_t)limits->file_bytes, (rlim_t)limits->file_bytes);
    if (memory && memory < ADDRESSABLE) limit(RLIMIT_AS, memory, memory);
}

/* Nicer than the service, whatever that is set to.  Under memory pressure the kernel takes the job first. */
static void be_modest(void) {
    int niceness = nice(NICE);
    (void)niceness; /* as nice as can be already */
    int fd = open("/proc/self/oom_score_adj", O_WRONLY | O_CLOEXEC);
    ssize_t n = fd >= 0 ? write(fd, "500", 3) : 0;
    (void)n;
    if (fd >= 0) close(fd);
}

/* ------------------------------------------------------------------------------------------------ privileges */

static void write_text(const char *path, const char *text, size_t bytes) {
    int fd = open(path, O_WRONLY | O_CLOEXEC);
    ssize_t n = fd >= 0 ? write(fd, text, bytes) : 0;
    (void)n; /* an identity that isn't mapped reads and writes all the same */
    if (fd >= 0) close(fd);
}

/* "ID ID 1": what snprintf would write, by nothing but arithmetic. */
static size_t identity_map(char text[32], unsigned id) {
    char digits[12];
    size_t count = 0, used = 0;
    do digits[count++] = (char)('0' + id % 10);
    while (id /= 10);
    for (int twice = 0; twice < 2; twice++) {
        for (size_t i = count; i--;) text[used++] = digits[i];
        text[used++] = ' ';
    }
    text[used++] = '1';
    return used;
}

/* Where that takes rights that we don't have, a user namespace gives them, with our own identity in it. */
static bool leave_network(void) {
    char map[32];
    if (unshare(CLONE_NEWNET) == 0) return true;
    unsigned user = geteuid(), group = getegid();
    if (unshare(CLONE_NEWUSER | CLONE_NEWNET) != 0) return false;
    write_text("/proc/self/setgroups", "deny", 4);
    write_text("/proc/self/uid_map", map, identity_map(map, user));
    write_text("/proc/self/gid_map", map, identity_map(map, group));
    return true;
}

/* Root reads what belongs to others by two of its capabilities; data may lie there, and Landlock guards the rest. */
static void drop_capabilities(void) {
    for (unsigned long c = 0; c <= 63; c++)
        if (c != CAP_DAC_OVERRIDE && c != CAP_DAC_READ_SEARCH && prctl(PR_CAPBSET_DROP, c, 0, 0, 0) != 0) return;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static bool may_leave_network(void) {
    int status = -1;
    pid_t pid = fork();
    if (pid == 0) _exit(leave_network() ? 0 : 1);
    while (pid > 0 && waitpid(pid, &status, 0) < 0 && errno == EINTR) continue;
    return pid > 0 && WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

enum status confine_open(const char *program, bool sandbox, struct confinement **confinement, struct error *error) {
    struct confinement *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "confinement", "no memory");
    opened->program = program;
    enum status status = STATUS_OK;
    if (sandbox) {
        opened->landlock = landlock_version();
        opened->no_network = may_leave_network();
        status = seccomp_filter_open(program, no_environment, &opened->filter, error);
    }
    if (status == STATUS_UNSUPPORTED) status = STATUS_OK;
    if (status == STATUS_OK)
        *confinement = opened;
    else
        confine_close(opened);
    return status;
}

void confine_close(struct confinement *confinement) {
    if (confinement) seccomp_filter_close(confinement->filter);
    free(confinement);
}

void confine_describe(const struct confinement *confinement, char text[CONFINE_TEXT_BYTES]) {
    char landlock[24] = "";
    if (confinement->landlock) snprintf(landlock, sizeof landlock, ", Landlock %d", confinement->landlock);
    snprintf(text, CONFINE_TEXT_BYTES, "limits, no new privileges%s%s%s", confinement->filter ? ", seccomp" : "",
             landlock, confinement->no_network ? ", no network" : "");
}

bool confine_this_process(const struct confinement *confinement, const struct confine_limits *limits,
                          const char *folder) {
    set_limits(limits);
    be_modest();
    if (confinement->no_network && !leave_network()) return false;
    drop_capabilities();
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* new privileges would have undone it */
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return false;
    if (confinement->landlock && !landlock_apply(confinement->landlock, confinement->program, folder)) return false;
    return !confinement->filter || seccomp_filter_apply(confinement->filter);
}

void confine_execute(const struct confinement *confinement, char *const *argv) {
    execve(confinement->program, argv, no_environment);
}
