/* The filter of system calls, by libseccomp.
 *
 * Three answers.  What whittle, its loader and its libraries call is allowed.  What nothing but a hijacked process
 * would call ends it with SIGSYS, so that the job's obituary tells of it.  Everything else fails with EPERM: a newer C
 * library that tries something new and has another way goes on.  clone3 fails with ENOSYS because its flags lie in
 * memory where a filter can't look; the C library falls back to clone, which is allowed for threads alone.
 *
 * The filter is put on before exec, so it holds whatever the program is, and so execve must get through once.  It does
 * for the two pointers that this process passes.  The program that runs then has other memory: it could forge them, but
 * what it could execute is itself, under the same filter (runner/landlock.c forbids to execute anything else).
 *
 * Memory is never writable and executable: mmap and mprotect refuse PROT_EXEC together with PROT_WRITE, and mprotect
 * refuses PROT_EXEC altogether.  The loader maps libraries as executable, so this filter can't refuse it for files. The
 * program does, with a filter of its own, before it reads its input (server/cli/no_new_code.c): prctl lets it.
 *
 * A process may send signals to itself, which is how abort() works.  Its id isn't known when the filter is made: a mark
 * stands for it, and the child writes its id over the mark.
 *
 * The kernel also sends signals on a process's behalf, and nothing here lets it choose to whom: fcntl does nothing but
 * duplicate descriptors and read flags (no F_SETOWN, F_SETSIG, O_ASYNC, leases, notifications or locks), ioctl asks for
 * a terminal's settings alone (no FIOASYNC, FIOSETOWN, SIOCSPGRP), and timers, message queues and asynchronous input
 * and output can't be made.  What names another process (prlimit64, get_robust_list) is refused for any but this one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/runner/seccomp.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sched.h>
#include <seccomp.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "core/base/fault.h"

enum { OWN_ID_MARK = 0x57aa11ed, MAX_INSTRUCTIONS = 4096 };

struct seccomp_filter {
    struct sock_fprog program; /* its instructions follow */
    struct sock_filter instruction[];
};

static const char *const allowed[] = {"read",
                                      "write",
                                      "readv",
                                      "writev",
                                      "pread64",
                                      "pwrite64",
                                      "lseek",
                                      "close",
                                      "fstat",
                                      "newfstatat",
                                      "stat",
                                      "lstat",
                                      "statx",
                                      "open",
                                      "openat",
                                      "access",
                                      "faccessat",
                                      "faccessat2",
                                      "getdents64",
                                      "mkdir",
                                      "mkdirat",
                                      "rename",
                                      "renameat",
                                      "renameat2",
                                      "unlink",
                                      "unlinkat",
                                      "ftruncate",
                                      "fallocate",
                                      "fsync",
                                      "fdatasync",
                                      "dup",
                                      "fadvise64",
                                      "munmap",
                                      "mremap",
                                      "madvise",
                                      "brk",
                                      "futex",
                                      "futex_waitv",
                                      "set_robust_list",
                                      "rseq",
                                      "set_tid_address",
                                      "exit",
                                      "exit_group",
                                      "rt_sigaction",
                                      "rt_sigprocmask",
                                      "rt_sigreturn",
                                      "sigaltstack",
                                      "restart_syscall",
                                      "sched_yield",
                                      "sched_getaffinity",
                                      "getrandom",
                                      "clock_gettime",
                                      "clock_getres",
                                      "clock_nanosleep",
                                      "nanosleep",
                                      "gettimeofday",
                                      "time",
                                      "getpid",
                                      "getppid",
                                      "gettid",
                                      "getuid",
                                      "geteuid",
                                      "getgid",
                                      "getegid",
                                      "getrusage",
                                      "getrlimit",
                                      "ugetrlimit",
                                      "times",
                                      "sysinfo",
                                      "uname",
                                      "arch_prctl",
                                      "poll",
                                      "ppoll",
                                      "membarrier"};

static const char *const deadly[] = {"socket",
                                     "socketpair",
                                     "connect",
                                     "bind",
                                     "listen",
                                     "accept",
                                     "accept4",
                                     "sendto",
                                     "sendmsg",
                                     "sendmmsg",
                                     "recvfrom",
                                     "recvmsg",
                                     "recvmmsg",
                                     "shutdown",
                                     "setsockopt",
                                     "getsockopt",
                                     "ptrace",
                                     "process_vm_readv",
                                     "process_vm_writev",
                                     "process_madvise",
                                     "fork",
                                     "vfork",
                                     "execveat",
                                     "kill",
                                     "tkill",
                                     "rt_sigqueueinfo",
                                     "rt_tgsigqueueinfo",
                                     "pidfd_open",
                                     "pidfd_getfd",
                                     "pidfd_send_signal",
                                     "mount",
                                     "umount2",
                                     "move_mount",
                                     "open_tree",
                                     "fsopen",
                                     "fsmount",
                                     "pivot_root",
                                     "chroot",
                                     "unshare",
                                     "setns",
                                     "bpf",
                                     "perf_event_open",
                                     "userfaultfd",
                                     "io_uring_setup",
                                     "io_uring_enter",
                                     "io_uring_register",
                                     "keyctl",
                                     "add_key",
                                     "request_key",
                                     "init_module",
                                     "finit_module",
                                     "delete_module",
                                     "kexec_load",
                                     "kexec_file_load",
                                     "reboot",
                                     "swapon",
                                     "swapoff",
                                     "setuid",
                                     "setgid",
                                     "setreuid",
                                     "setregid",
                                     "setresuid",
                                     "setresgid",
                                     "setgroups",
                                     "capset",
                                     "personality",
                                     "open_by_handle_at",
                                     "name_to_handle_at",
                                     "memfd_create",
                                     "memfd_secret",
                                     "shmget",
                                     "msgget",
                                     "semget",
                                     "mknod",
                                     "mknodat",
                                     "symlink",
                                     "symlinkat",
                                     "link",
                                     "linkat",
                                     "chmod",
                                     "fchmod",
                                     "fchmodat",
                                     "chown",
                                     "fchown",
                                     "lchown",
                                     "fchownat",
                                     "acct",
                                     "quotactl",
                                     "settimeofday",
                                     "clock_settime",
                                     "iopl",
                                     "ioperm",
                                     "modify_ldt"};

/* Allowed for these arguments; what else they are asked for fails, or is deadly. */
struct narrow {
    const char *name;
    uint32_t action;
    unsigned count;
    struct scmp_arg_cmp argument[2];
};

#define ALLOWED SCMP_ACT_ALLOW
#define DEADLY SCMP_ACT_KILL_PROCESS
#define EXACTLY(i, value) SCMP_CMP64(i, SCMP_CMP_EQ, (scmp_datum_t)(value), 0)
#define OTHER_THAN(i, value) SCMP_CMP64(i, SCMP_CMP_NE, (scmp_datum_t)(value), 0)
#define MASKED(i, mask, value) SCMP_CMP64(i, SCMP_CMP_MASKED_EQ, (scmp_datum_t)(mask), (scmp_datum_t)(value))

/* What the C library starts a thread with; musl adds CLONE_DETACHED, which does nothing. */
#define OF_A_THREAD                                                                                                    \
    (CLONE_VM | CLONE_FS | CLONE_FILES | CLONE_SIGHAND | CLONE_THREAD | CLONE_SYSVSEM | CLONE_SETTLS |                 \
     CLONE_PARENT_SETTID | CLONE_CHILD_CLEARTID)

static const struct narrow narrow[] = {
    {"clone", ALLOWED, 1, {MASKED(0, ~(uint64_t)CLONE_DETACHED, OF_A_THREAD)}},
    {"clone", DEADLY, 1, {MASKED(0, CLONE_THREAD, 0)}},
    {"mmap", ALLOWED, 1, {MASKED(2, PROT_EXEC, 0)}},
    {"mmap", ALLOWED, 1, {MASKED(2, PROT_EXEC | PROT_WRITE, PROT_EXEC)}},
    {"mprotect", ALLOWED, 1, {MASKED(2, PROT_EXEC, 0)}},
    {"prlimit64", ALLOWED, 2, {EXACTLY(0, 0), EXACTLY(2, 0)}},
    {"prctl", ALLOWED, 2, {EXACTLY(0, PR_SET_SECCOMP), EXACTLY(1, SECCOMP_MODE_FILTER)}},
    {"fcntl", ALLOWED, 1, {EXACTLY(1, F_DUPFD)}},
    {"fcntl", ALLOWED, 1, {EXACTLY(1, F_GETFD)}},
    {"fcntl", ALLOWED, 1, {EXACTLY(1, F_SETFD)}},
    {"fcntl", ALLOWED, 1, {EXACTLY(1, F_GETFL)}},
    {"fcntl", ALLOWED, 1, {EXACTLY(1, F_DUPFD_CLOEXEC)}},
    {"ioctl", ALLOWED, 1, {EXACTLY(1, TCGETS)}},
    {"tgkill", ALLOWED, 1, {EXACTLY(0, OWN_ID_MARK)}},
    {"clone3", SCMP_ACT_ERRNO(ENOSYS), 0, {{0}}},
};

/* A name that this processor doesn't have is none to worry about. */
static int add_rule(scmp_filter_ctx ctx, uint32_t action, const char *name, unsigned count,
                    const struct scmp_arg_cmp *arguments) {
    int number = seccomp_syscall_resolve_name(name);
    return number < 0 ? 0 : seccomp_rule_add_array(ctx, action, number, count, arguments);
}

static int add_rules(scmp_filter_ctx ctx, const char *program, char *const *environment) {
    int failed = 0;
    const struct scmp_arg_cmp once[2] = {EXACTLY(0, (uintptr_t)program), EXACTLY(2, (uintptr_t)environment)};
    const struct scmp_arg_cmp again = OTHER_THAN(0, (uintptr_t)program);
    for (size_t i = 0; !failed && i < sizeof allowed / sizeof *allowed; i++)
        failed = add_rule(ctx, ALLOWED, allowed[i], 0, NULL);
    for (size_t i = 0; !failed && i < sizeof deadly / sizeof *deadly; i++)
        failed = add_rule(ctx, DEADLY, deadly[i], 0, NULL);
    for (size_t i = 0; !failed && i < sizeof narrow / sizeof *narrow; i++)
        failed = add_rule(ctx, narrow[i].action, narrow[i].name, narrow[i].count, narrow[i].argument);
    if (!failed) failed = add_rule(ctx, ALLOWED, "execve", 2, once);
    return failed ? failed : add_rule(ctx, DEADLY, "execve", 1, &again);
}

/* What libseccomp writes to a file, in memory. */
static struct seccomp_filter *read_filter(int fd) {
    off_t bytes = lseek(fd, 0, SEEK_END);
    size_t count = bytes > 0 ? (size_t)bytes / sizeof(struct sock_filter) : 0;
    if (!count || count > MAX_INSTRUCTIONS) return NULL;
    struct seccomp_filter *filter = malloc(sizeof *filter + (size_t)bytes);
    if (!filter) return NULL;
    filter->program = (struct sock_fprog){.len = (unsigned short)count, .filter = filter->instruction};
    if (pread(fd, filter->instruction, (size_t)bytes, 0) == bytes) return filter;
    free(filter);
    return NULL;
}

static struct seccomp_filter *make_filter(const char *program, char *const *environment) {
    struct seccomp_filter *filter = NULL;
    scmp_filter_ctx ctx = seccomp_init(SCMP_ACT_ERRNO(EPERM));
    int fd = ctx ? memfd_create("filter", MFD_CLOEXEC) : -1;
    if (fd >= 0 && seccomp_attr_set(ctx, SCMP_FLTATR_ACT_BADARCH, DEADLY) == 0 &&
        seccomp_attr_set(ctx, SCMP_FLTATR_CTL_OPTIMIZE, 2) == 0 && add_rules(ctx, program, environment) == 0 &&
        seccomp_export_bpf(ctx, fd) == 0)
        filter = read_filter(fd);
    if (fd >= 0) close(fd);
    if (ctx) seccomp_release(ctx);
    return filter;
}

/* An impossible filter is refused with EFAULT where filters exist at all. */
static bool kernel_has_filters(void) {
    return prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, NULL, 0, 0) != 0 && errno == EFAULT;
}

enum status seccomp_filter_open(const char *program, char *const *environment, struct seccomp_filter **filter,
                                struct error *error) {
    if (fault_at("seccomp") || !kernel_has_filters())
        return error_set(error, STATUS_UNSUPPORTED, "seccomp", "the kernel has no filters");
    *filter = make_filter(program, environment);
    return *filter ? STATUS_OK : error_set(error, STATUS_ENGINE, "seccomp", "the filter can't be made");
}

void seccomp_filter_close(struct seccomp_filter *filter) { free(filter); }

bool seccomp_filter_apply(struct seccomp_filter *filter) {
    for (unsigned i = 0; i < filter->program.len; i++)
        if (filter->instruction[i].k == OWN_ID_MARK) filter->instruction[i].k = (uint32_t)getpid();
    return prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &filter->program, 0, 0) == 0;
}
