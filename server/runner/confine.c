/* A job's process is confined between fork and exec, by the service and not by itself: so it holds from the program's
 * first instruction, for the loader too, and for any program that `worker` names.
 *
 *     own process ids     a namespace of them, in which the job can't name the service, nor anybody else, to        [*]
 *                         signal it; entered before the fork of the process, with the network's (runner/spawn.c)
 *     limits              address space, data, stack, processor time, length of a file, descriptors, no core file
 *     manners             it gives way to the service: nice, and first to go where memory is short
 *     no network          a network namespace with nothing in it, in a user namespace where that takes no rights    [*]
 *     threads             their number, where a user namespace counts them; else runner/footprint.c looks at it     [*]
 *     no capabilities     where the service has any
 *     account, folder     that of --job-user; the job's folder is the present one
 *     death               it ends with the thread that has forked it
 *     no new privileges   no set-user-id program gives any
 *     Landlock            files: runner/landlock.c                                                                  [*]
 *     seccomp             system calls: runner/seccomp.c                                                            [*]
 *
 * In this order, because the last would forbid what those before it do.  A kernel that lacks some of those marked [*]
 * is no reason not to start: the log says what holds, and whether that is enough is for the operator to say.  But what
 * was there at the start must hold for each job, or the job doesn't run.  The others hold always.
 *
 * A process of the same user may open another's memory in /proc.  Landlock forbids that, and so does a user namespace.
 * Where there is neither, the service's own memory is closed to everybody but root, which costs it its core dumps.
 *
 * A program built with sanitizers can't be confined so: they reserve terabytes, start processes and read /proc.  That
 * is what worker-sandbox=off is for; limits stay.
 *
 * An account of the jobs' own (job-user) takes rights: root's, or four capabilities.  Then no signal of theirs reaches
 * the service and no file of its is theirs to open, whatever the kernel has of the rest.
 *
 * Missing on purpose: a mount namespace, a control group.  They take rights that the service needn't have; where it
 * runs as a unit or a container, its manager gives them to all of it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/runner/confine.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/capability.h>
#include <pwd.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/base/fault.h"
#include "server/runner/landlock.h"
#include "server/runner/seccomp.h"

enum { MAX_FILES = 64, NICE = 5, CPU_GRACE_S = 5, KEEPERS = 2, SHARED_MODE = 0770 };

struct confinement {
    const char *program;
    const char *user; /* "": our own */
    uid_t uid;
    gid_t gid;
    struct seccomp_filter *filter; /* NULL: none */
    int landlock;                  /* its version; 0: none */
    bool no_network;
    bool own_pids;       /* those of a job's processes are its own: it has no name for any other */
    bool counts_threads; /* those of a job's process alone, so that they can be limited */
};

static char *const no_environment[] = {NULL};

/* ------------------------------------------------------------------------------------------------ limits */

static void limit(unsigned resource, rlim_t soft, rlim_t hard) {
    struct rlimit limits = {soft, hard};
    setrlimit(resource, &limits);
}

/* SIGXCPU at the limit of time, SIGKILL a little later.  More memory than a process can address is no limit, and isn't
 * set as one: a program under ThreadSanitizer would refuse to run. */
static void set_limits(const struct confine_limits *limits) {
    rlim_t cpu_s = (rlim_t)((limits->cpu_ms + 999) / 1000), memory = (rlim_t)limits->memory_bytes;
    limit(RLIMIT_CORE, 0, 0);
    limit(RLIMIT_NOFILE, MAX_FILES + (rlim_t)limits->files, MAX_FILES + (rlim_t)limits->files);
    limit(RLIMIT_CPU, cpu_s, cpu_s + CPU_GRACE_S);
    limit(RLIMIT_FSIZE, (rlim_t)limits->file_bytes, (rlim_t)limits->file_bytes);
    if (memory && limits->memory_bytes < CONFINE_ADDRESSABLE) limit(RLIMIT_AS, memory, memory);
    if (limits->data_bytes) limit(RLIMIT_DATA, (rlim_t)limits->data_bytes, (rlim_t)limits->data_bytes);
    limit(RLIMIT_STACK, CONFINE_STACK_BYTES, CONFINE_STACK_BYTES); /* of each thread, too */
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

/* Where that takes rights that we don't have, a user namespace gives them, with our own identity in it alone: so not
 * where another account is to be taken. */
static bool enter_namespaces(const struct confinement *confinement, int which) {
    char map[32];
    if (unshare(which) == 0) return true;
    unsigned user = geteuid(), group = getegid();
    if (confinement->user[0] || unshare(CLONE_NEWUSER | which) != 0) return false;
    write_text("/proc/self/setgroups", "deny", 4);
    write_text("/proc/self/uid_map", map, identity_map(map, user));
    write_text("/proc/self/gid_map", map, identity_map(map, group));
    return true;
}

/* Root's go with its identity; those that were given to another user would stay. */
static bool drop_all_capabilities(void) {
    struct __user_cap_header_struct version = {.version = _LINUX_CAPABILITY_VERSION_3};
    struct __user_cap_data_struct none[_LINUX_CAPABILITY_U32S_3] = {{0}};
    return syscall(SYS_capset, &version, none) == 0;
}

/* The account's identity and nothing of ours.  false: it isn't ours to take. */
static bool become_user(const struct confinement *confinement) {
    return syscall(SYS_setgroups, 0, NULL) == 0 &&
           syscall(SYS_setresgid, confinement->gid, confinement->gid, confinement->gid) == 0 &&
           syscall(SYS_setresuid, confinement->uid, confinement->uid, confinement->uid) == 0 && drop_all_capabilities();
}

/* The folder becomes the account's, and is stood in: those above it stay closed to the account.  Our group stays, so
 * that we see into it. */
static bool enter_folder(const struct confinement *confinement, const char *folder) {
    if (chdir(folder) != 0) return false;
    return !confinement->user[0] ||
           (chmod(".", SHARED_MODE) == 0 && chown(".", confinement->uid, (gid_t)-1) == 0 && become_user(confinement));
}

/* Root reads what belongs to others by two of its capabilities; data may lie there, and Landlock guards the rest. */
static void drop_capabilities(void) {
    for (unsigned long c = 0; c <= 63; c++)
        if (c != CAP_DAC_OVERRIDE && c != CAP_DAC_READ_SEARCH && prctl(PR_CAPBSET_DROP, c, 0, 0, 0) != 0) return;
}

/* ------------------------------------------------------------------------------------------------ the whole */

/* The exit status of a child, -1: there is none. */
static int wait_for_child(pid_t pid) {
    int status = -1;
    while (pid > 0 && waitpid(pid, &status, 0) < 0 && errno == EINTR) continue;
    return pid > 0 && WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

static bool may_fork_with(rlim_t processes) {
    limit(RLIMIT_NPROC, processes, 2);
    pid_t pid = fork();
    if (pid == 0) _exit(0);
    return wait_for_child(pid) == 0;
}

/* Linux counts a user's processes in each user namespace for itself, since 5.14, and root's in none.  Where it counts
 * otherwise, a limit is of no use, or would be reached by what others do. */
static bool counts_threads(void) { return may_fork_with(2) && !may_fork_with(1); }

static bool leaves_network(const struct confinement *confinement) {
    return enter_namespaces(confinement, CLONE_NEWNET);
}

static bool limits_threads(const struct confinement *confinement) {
    return leaves_network(confinement) && counts_threads();
}

static bool has_own_pids(const struct confinement *confinement) {
    if (!confine_enter_namespaces(confinement)) return false;
    pid_t pid = fork();
    if (pid == 0) _exit(getpid() == 1 ? 0 : 1);
    return wait_for_child(pid) == 0;
}

/* Whether the kernel gives that, tried in a child. */
static bool is_given(const struct confinement *confinement, bool (*gives)(const struct confinement *confinement)) {
    pid_t pid = fork();
    if (pid == 0) _exit(gives(confinement) ? 0 : 1);
    return wait_for_child(pid) == 0;
}

/* Looks the account up, and tries in a child whether it can execute the program. */
static enum status find_user(struct confinement *confinement, const char *user, struct error *error) {
    confinement->user = user;
    if (!user[0]) return STATUS_OK;
    const struct passwd *account = getpwnam(user);
    if (!account || !account->pw_uid)
        return error_set(error, STATUS_BAD_PARAMETER, "job-user", "'%.80s' is no account other than root's", user);
    confinement->uid = account->pw_uid;
    confinement->gid = account->pw_gid;
    pid_t pid = fork();
    if (pid == 0) _exit(!become_user(confinement) ? 1 : access(confinement->program, X_OK) != 0 ? 2 : 0);
    switch (wait_for_child(pid)) {
    case 0: return STATUS_OK;
    case 2:
        return error_set(error, STATUS_BAD_PARAMETER, "job-user", "%.80s can't execute %.200s", user,
                         confinement->program);
    default:
        return error_set(error, STATUS_BAD_PARAMETER, "job-user",
                         "to run jobs as %.80s the service has to start as root, or with the capabilities CAP_SETUID, "
                         "CAP_SETGID, CAP_CHOWN and CAP_KILL",
                         user);
    }
}

enum status confine_open(const char *program, bool sandbox, const char *user, struct confinement **confinement,
                         struct error *error) {
    struct confinement *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "confinement", "no memory");
    opened->program = program;
    enum status status = find_user(opened, user, error);
    if (status == STATUS_OK && sandbox) {
        opened->landlock = landlock_version();
        bool namespaces = !fault_at("namespaces");
        opened->no_network = namespaces && is_given(opened, leaves_network);
        opened->counts_threads = namespaces && is_given(opened, limits_threads);
        opened->own_pids = namespaces && !fault_at("pid-namespace") && is_given(opened, has_own_pids);
        if (!opened->landlock && !opened->no_network) prctl(PR_SET_DUMPABLE, 0); /* its memory isn't a job's to open */
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
    snprintf(text, CONFINE_TEXT_BYTES, "limits, no new privileges%s%.32s%s%s%s%s%s",
             confinement->user[0] ? ", user " : "", confinement->user, confinement->filter ? ", seccomp" : "", landlock,
             confinement->no_network ? ", no network" : "", confinement->own_pids ? ", own process ids" : "",
             confinement->counts_threads ? ", threads" : "");
}

bool confine_measure(const struct confinement *confinement, size_t i, const char **name, int64_t *value) {
    const struct {
        const char *name;
        int64_t value;
    } measures[] = {{"seccomp", confinement->filter != NULL},      {"landlock", confinement->landlock},
                    {"no_network", confinement->no_network},       {"own_process_ids", confinement->own_pids},
                    {"thread_limit", confinement->counts_threads}, {"own_account", confinement->user[0] != 0}};
    if (i >= sizeof measures / sizeof *measures) return false;
    *name = measures[i].name;
    *value = measures[i].value;
    return true;
}

bool confine_has_own_pids(const struct confinement *confinement) { return confinement->own_pids; }

bool confine_enter_namespaces(const struct confinement *confinement) {
    return enter_namespaces(confinement, CLONE_NEWNET | CLONE_NEWPID);
}

bool confine_this_process(const struct confinement *confinement, const struct confine_limits *limits,
                          const char *folder) {
    set_limits(limits);
    be_modest();
    if (confinement->no_network && !confinement->own_pids && !leaves_network(confinement)) return false;
    rlim_t threads = (rlim_t)limits->threads + (confinement->own_pids ? KEEPERS : 0);
    if (confinement->counts_threads) limit(RLIMIT_NPROC, threads, threads);
    drop_capabilities();
    prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0); /* else they would outlive execve */
    if (!enter_folder(confinement, folder)) return false;
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* new privileges would have undone it */
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return false;
    if (confinement->landlock && !landlock_apply(confinement->landlock, confinement->program, ".")) return false;
    return !confinement->filter || seccomp_filter_apply(confinement->filter);
}

void confine_execute(const struct confinement *confinement, char *const *argv) {
    execve(confinement->program, argv, no_environment);
}
