/* A job's process that does what a hijacked one would try.  The daemon is told to run it in place of whittle, and it
 * confines itself as whittle does before it reads; the first lines of the input, "# service PID" (of the service, which
 * the probe may have no name for) and "# probe DEED ARGUMENT", say what to try.  It tells on descriptor 3 whether it
 * got through:
 *
 *     failed malformed 0 - probe refused: Operation not permitted
 *     failed malformed 0 - probe got through
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "server/cli/no_new_code.h"

enum { TEXT_BYTES = 512, BLOCK_BYTES = 1 << 20 };

static int service; /* its process id */

/* Each answers whether it got through, with errno where it didn't. */
struct deed {
    const char *name;
    bool (*try)(const char *argument, const char *folder);
};

static bool try_read(const char *path, const char *folder) {
    (void)folder;
    return open(path, O_RDONLY) >= 0;
}

static bool try_list(const char *path, const char *folder) {
    (void)folder;
    return open(path, O_RDONLY | O_DIRECTORY) >= 0;
}

static bool try_write(const char *path, const char *folder) {
    (void)folder;
    return open(path, O_WRONLY | O_CREAT, 0600) >= 0;
}

static bool try_above(const char *name, const char *folder) {
    char path[TEXT_BYTES * 2];
    snprintf(path, sizeof path, "%s/../%s", folder, name);
    return open(path, O_WRONLY | O_CREAT, 0600) >= 0;
}

static bool try_rename(const char *path, const char *folder) {
    char from[TEXT_BYTES * 2];
    snprintf(from, sizeof from, "%s/file", folder);
    close(open(from, O_WRONLY | O_CREAT, 0600));
    return rename(from, path) == 0;
}

static bool try_link(const char *path, const char *folder) {
    char to[TEXT_BYTES * 2];
    snprintf(to, sizeof to, "%s/link", folder);
    return symlink(path, to) == 0;
}

static bool try_socket(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return socket(AF_INET, SOCK_STREAM, 0) >= 0;
}

static bool try_fork(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    pid_t pid = fork();
    if (pid == 0) _exit(0);
    return pid > 0;
}

static bool try_exec(const char *program, const char *folder) {
    (void)folder;
    execl(program, program, (char *)NULL);
    return false;
}

static bool try_trace(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return ptrace(PTRACE_ATTACH, service, 0, 0) == 0;
}

static bool try_signal(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return syscall(SYS_tgkill, service, service, 0) == 0;
}

static bool try_kill(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return syscall(SYS_kill, service, SIGKILL) == 0;
}

/* Lets the kernel send SIGKILL to the service for each line that is written to it. */
static bool try_own(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    if (fcntl(3, F_SETOWN, service) != 0 || fcntl(3, F_SETSIG, SIGKILL) != 0 || fcntl(3, F_SETFL, O_ASYNC) != 0)
        return false;
    dprintf(3, "progress own 0.6 \n");
    return true;
}

/* A number whose lower half the kernel takes for the command, and a filter for something else. */
#define WIDE (UINT64_C(1) << 32)

static bool try_fcntl(const char *name, const char *folder) {
    struct f_owner_ex owner = {F_OWNER_PID, service};
    struct flock lock = {.l_type = F_WRLCK, .l_whence = SEEK_SET};
    const struct {
        const char *name;
        uint64_t command;
        uintptr_t argument;
    } commands[] = {
        {"setown", F_SETOWN, (uintptr_t)service},
        {"setown-group", F_SETOWN, (uintptr_t)-service},
        {"setown-wide", WIDE | F_SETOWN, (uintptr_t)service},
        {"setown-ex", F_SETOWN_EX, (uintptr_t)&owner},
        {"setsig", F_SETSIG, SIGKILL},
        {"async", F_SETFL, O_ASYNC},
        {"async-wide", WIDE | F_SETFL, O_ASYNC},
        {"lease", F_SETLEASE, F_RDLCK},
        {"notify", F_NOTIFY, DN_CREATE},
        {"lock", F_SETLK, (uintptr_t)&lock},
        {"lock-wait", F_SETLKW, (uintptr_t)&lock},
        {"lock-file", F_OFD_SETLK, (uintptr_t)&lock},
        {"pipe", F_SETPIPE_SZ, 1 << 20},
        {"dup-wide", WIDE | F_DUPFD, 10},
    };
    (void)folder;
    for (size_t i = 0; i < sizeof commands / sizeof *commands; i++)
        if (strcmp(commands[i].name, name) == 0)
            return syscall(SYS_fcntl, 3, commands[i].command, commands[i].argument) >= 0;
    errno = ENOSYS;
    return false;
}

/* What fcntl a job has use for. */
static bool try_flags(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    int fd = fcntl(0, F_DUPFD, 10), other = fcntl(0, F_DUPFD_CLOEXEC, 10);
    return fd >= 10 && other > fd && fcntl(fd, F_SETFD, FD_CLOEXEC) == 0 && fcntl(fd, F_GETFD) == FD_CLOEXEC &&
           fcntl(fd, F_GETFL) >= 0;
}

static bool try_ioctl(const char *name, const char *folder) {
    int on = 1, owner = service;
    char key = 'x';
    const struct {
        const char *name;
        uint64_t request;
        void *argument;
    } requests[] = {{"fioasync", FIOASYNC, &on},          {"fiosetown", FIOSETOWN, &owner},
                    {"siocspgrp", SIOCSPGRP, &owner},     {"fionbio", FIONBIO, &on},
                    {"tiocsti", TIOCSTI, &key},           {"tiocspgrp", TIOCSPGRP, &owner},
                    {"async-wide", WIDE | FIOASYNC, &on}, {"tcgets-wide", WIDE | TCGETS, &on}};
    (void)folder;
    for (size_t i = 0; i < sizeof requests / sizeof *requests; i++)
        if (strcmp(requests[i].name, name) == 0)
            return syscall(SYS_ioctl, 3, requests[i].request, requests[i].argument) >= 0;
    errno = ENOSYS;
    return false;
}

/* Facts and limits of the service's process. */
static bool try_limits(const char *argument, const char *folder) {
    unsigned long pair[2];
    (void)argument, (void)folder;
    return syscall(SYS_prlimit64, service, 7 /* RLIMIT_NOFILE */, NULL, pair) == 0;
}

/* The service's own memory. */
static bool try_parent(const char *name, const char *folder) {
    char path[TEXT_BYTES * 2];
    (void)folder;
    snprintf(path, sizeof path, "/proc/%d/%s", service, name);
    return open(path, O_RDWR) >= 0;
}

static bool try_abort(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    abort();
}

static bool try_code(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return mmap(NULL, 4096, PROT_READ | PROT_WRITE | PROT_EXEC, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) != MAP_FAILED;
}

/* Code in a file of its own, or in its input. */
static bool try_mapped(const char *argument, const char *folder) {
    char path[TEXT_BYTES * 2];
    (void)argument;
    snprintf(path, sizeof path, "%s/code", folder);
    int fd = open(path, O_RDWR | O_CREAT, 0700);
    if (fd < 0 || write(fd, "\xc3", 1) != 1) return false;
    return mmap(NULL, 4096, PROT_READ | PROT_EXEC, MAP_PRIVATE, fd, 0) != MAP_FAILED;
}

static bool try_input(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return mmap(NULL, 4096, PROT_EXEC, MAP_PRIVATE, 0, 0) != MAP_FAILED;
}

static bool try_protect(const char *argument, const char *folder) {
    void *page = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    (void)argument, (void)folder;
    return page != MAP_FAILED && mprotect(page, 4096, PROT_READ | PROT_EXEC) == 0;
}

/* A third filter. */
static bool try_filter(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return command_no_new_code();
}

/* What comes to it when its parent ends; the argument is the signal's number. */
static bool try_outlive(const char *signal, const char *folder) {
    (void)folder;
    return prctl(PR_SET_PDEATHSIG, strtoul(signal, NULL, 10), 0, 0, 0) == 0;
}

/* A program of its own, in the one folder that it may write. */
static bool try_own_program(const char *argument, const char *folder) {
    char path[TEXT_BYTES * 2];
    (void)argument;
    snprintf(path, sizeof path, "%s/program", folder);
    int fd = open(path, O_WRONLY | O_CREAT, 0700);
    if (fd < 0 || write(fd, "x", 1) != 1 || close(fd) != 0) return false;
    execl(path, path, (char *)NULL);
    return errno == ENOEXEC; /* it was tried, and is no program */
}

static bool try_unlimit(const char *argument, const char *folder) {
    struct rlimit_pair {
        unsigned long soft, hard;
    } most = {~0UL, ~0UL};
    (void)argument, (void)folder;
    return syscall(SYS_prlimit64, 0, 1 /* RLIMIT_FSIZE */, &most, NULL) == 0;
}

static bool try_call(const char *name, const char *folder) {
    static const struct {
        const char *name;
        long number;
    } calls[] = {
        {"unshare", SYS_unshare},
        {"setns", SYS_setns},
        {"mount", SYS_mount},
        {"umount2", SYS_umount2},
        {"pivot_root", SYS_pivot_root},
        {"chroot", SYS_chroot},
        {"kill", SYS_kill},
        {"tkill", SYS_tkill},
        {"process_vm_readv", SYS_process_vm_readv},
        {"pidfd_open", SYS_pidfd_open},
        {"io_uring_setup", SYS_io_uring_setup},
        {"bpf", SYS_bpf},
        {"perf_event_open", SYS_perf_event_open},
        {"userfaultfd", SYS_userfaultfd},
        {"keyctl", SYS_keyctl},
        {"execveat", SYS_execveat},
        {"setuid", SYS_setuid},
        {"setgroups", SYS_setgroups},
        {"memfd_create", SYS_memfd_create},
        {"personality", SYS_personality},
        {"linkat", SYS_linkat},
        {"mknodat", SYS_mknodat},
        {"fchmodat", SYS_fchmodat},
        {"fchownat", SYS_fchownat},
        {"setxattr", SYS_setxattr},
        {"open_by_handle_at", SYS_open_by_handle_at},
        {"inotify_init1", SYS_inotify_init1},
        {"fanotify_init", SYS_fanotify_init},
        {"shmget", SYS_shmget},
        {"msgget", SYS_msgget},
        {"mq_open", SYS_mq_open},
        {"init_module", SYS_init_module},
        {"reboot", SYS_reboot},
        {"sethostname", SYS_sethostname},
        {"settimeofday", SYS_settimeofday},
        {"setpriority", SYS_setpriority},
        {"sched_setaffinity", SYS_sched_setaffinity},
        {"setpgid", SYS_setpgid},
        {"setsid", SYS_setsid},
        {"ioctl", SYS_ioctl},
        {"chdir", SYS_chdir},
        {"quotactl", SYS_quotactl},
        {"tgkill", SYS_tgkill},
        {"rt_sigqueueinfo", SYS_rt_sigqueueinfo},
        {"rt_tgsigqueueinfo", SYS_rt_tgsigqueueinfo},
        {"pidfd_send_signal", SYS_pidfd_send_signal},
        {"timer_create", SYS_timer_create},
        {"setitimer", SYS_setitimer},
        {"mq_notify", SYS_mq_notify},
        {"io_setup", SYS_io_setup},
        {"io_submit", SYS_io_submit},
        {"prctl", SYS_prctl},
        {"get_robust_list", SYS_get_robust_list},
        {"kcmp", SYS_kcmp},
        {"fallocate", SYS_fallocate},
        {"copy_file_range", SYS_copy_file_range},
        {"sched_setscheduler", SYS_sched_setscheduler},
        {"ioprio_set", SYS_ioprio_set},
        {"flock", SYS_flock},
        {"seccomp", SYS_seccomp},
        {"unknown", 100000},
#ifdef __x86_64__
        {"x32", 0x40000000 | SYS_socket},
#endif
    };
    (void)folder;
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++)
        if (strcmp(calls[i].name, name) == 0) return syscall(calls[i].number, 0, 0, 0, 0, 0, 0) >= 0;
    errno = ENOSYS;
    return false;
}

/* A call by the door of 32-bit programs, where numbers mean something else. */
static bool try_old(const char *argument, const char *folder) {
    (void)argument, (void)folder;
#ifdef __x86_64__
    long answer = 359; /* socket */
    __asm__ volatile("int $0x80" : "+a"(answer) : "b"(2), "c"(1), "d"(0) : "memory");
    errno = (int)-answer;
    return answer >= 0;
#else
    raise(SIGSYS);
    return false;
#endif
}

static bool try_memory(const char *argument, const char *folder) {
    (void)folder;
    for (long left = strtol(argument, NULL, 10); left > 0; left--) {
        char *block = malloc(BLOCK_BYTES);
        if (!block) return false;
        memset(block, 1, BLOCK_BYTES);
    }
    return true;
}

static bool try_time(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    for (volatile unsigned long i = 1; i; i++) continue;
    return true;
}

static bool try_length(const char *argument, const char *folder) {
    static char block[BLOCK_BYTES];
    char path[TEXT_BYTES * 2];
    snprintf(path, sizeof path, "%s/file", folder);
    signal(SIGXFSZ, SIG_IGN);
    int fd = open(path, O_WRONLY | O_CREAT, 0600);
    for (long left = strtol(argument, NULL, 10); left > 0; left--)
        if (write(fd, block, sizeof block) != (ssize_t)sizeof block) return false;
    return true;
}

static bool try_files(const char *argument, const char *folder) {
    (void)folder;
    for (long left = strtol(argument, NULL, 10); left > 0; left--)
        if (dup(0) < 0) return false;
    return true;
}

static void *do_nothing(void *ctx) { return ctx; }

static bool try_thread(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    pthread_t thread;
    errno = pthread_create(&thread, NULL, do_nothing, NULL);
    return errno == 0 && pthread_join(thread, NULL) == 0;
}

static void *wait_for_ever(void *ctx) {
    while (pause() != 0) continue;
    return ctx;
}

/* As many threads as it can have, and stays with them. */
static bool try_threads(const char *argument, const char *folder) {
    (void)folder;
    pthread_t thread;
    pthread_attr_t small;
    pthread_attr_init(&small);
    pthread_attr_setstacksize(&small, 1 << 16);
    for (long left = strtol(argument, NULL, 10); left > 0; left--)
        if ((errno = pthread_create(&thread, &small, wait_for_ever, NULL)) != 0) return false;
    wait_for_ever(NULL);
    return true;
}

/* So many files that stay; then it waits to be ended. */
static bool try_many(const char *argument, const char *folder) {
    char path[TEXT_BYTES * 2];
    for (long left = strtol(argument, NULL, 10); left > 0; left--) {
        snprintf(path, sizeof path, "%s/.%ld", folder, left);
        int fd = open(path, O_WRONLY | O_CREAT, 0600);
        if (fd < 0) return false;
        close(fd);
    }
    wait_for_ever(NULL);
    return true;
}

/* So many files of a mebibyte each, of which none stays; then it waits to be ended. */
static bool try_sum(const char *argument, const char *folder) {
    static char block[BLOCK_BYTES];
    char path[TEXT_BYTES * 2];
    snprintf(path, sizeof path, "%s/file", folder);
    for (long left = strtol(argument, NULL, 10); left > 0; left--) {
        int fd = open(path, O_WRONLY | O_CREAT, 0600);
        if (write(fd, block, sizeof block) != (ssize_t)sizeof block) return false;
        close(fd);
        unlink(path);
    }
    wait_for_ever(NULL);
    return true;
}

static bool try_nothing(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    while (pause() != 0) continue;
    return true;
}

static const struct deed deeds[] = {
    {"read", try_read},           {"list", try_list},       {"write", try_write},     {"above", try_above},
    {"rename", try_rename},       {"link", try_link},       {"socket", try_socket},   {"fork", try_fork},
    {"exec", try_exec},           {"trace", try_trace},     {"signal", try_signal},   {"abort", try_abort},
    {"code", try_code},           {"memory", try_memory},   {"unlimit", try_unlimit}, {"time", try_time},
    {"call", try_call},           {"old", try_old},         {"length", try_length},   {"files", try_files},
    {"thread", try_thread},       {"nothing", try_nothing}, {"own", try_own},         {"fcntl", try_fcntl},
    {"flags", try_flags},         {"ioctl", try_ioctl},     {"limits", try_limits},   {"parent", try_parent},
    {"mapped", try_mapped},       {"input", try_input},     {"protect", try_protect}, {"filter", try_filter},
    {"program", try_own_program}, {"threads", try_threads}, {"many", try_many},       {"sum", try_sum},
    {"kill", try_kill},           {"outlive", try_outlive},
};

static void try_deed(const char *name, const char *argument, const char *folder) {
    for (size_t i = 0; i < sizeof deeds / sizeof *deeds; i++) {
        if (strcmp(deeds[i].name, name) != 0) continue;
        bool through = deeds[i].try(argument, folder);
        dprintf(3, "failed malformed 0 - probe %s%s\n",
                through ? "got through" : "refused: ", through ? "" : strerror(errno));
    }
}

int main(int argc, char **argv) {
    char deed[64] = "", argument[TEXT_BYTES] = "", *folder = "";
    for (int i = 1; i + 1 < argc; i++)
        if (strcmp(argv[i], "-o") == 0) folder = argv[i + 1];
    command_no_new_code();
    if (fscanf(stdin, "# service %d\n# probe %63s %511s", &service, deed, argument) < 2) return 1;
    dprintf(3, "progress %s 0.5 \n", deed);
    try_deed(deed, argument, folder);
    return 65;
}
