/* A job's process that does what a hijacked one would try.  The daemon is told to run it in place of whittle; the first
 * line of the input, "# probe DEED ARGUMENT", says what to try.  It tells on descriptor 3 whether it got through:
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
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/ptrace.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

enum { TEXT_BYTES = 512, BLOCK_BYTES = 1 << 20 };

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
    return ptrace(PTRACE_ATTACH, getppid(), 0, 0) == 0;
}

static bool try_signal(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return syscall(SYS_tgkill, getppid(), getppid(), 0) == 0;
}

static bool try_abort(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    abort();
}

static bool try_code(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    return mmap(NULL, 4096, PROT_READ | PROT_WRITE | PROT_EXEC, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) != MAP_FAILED;
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

static bool try_nothing(const char *argument, const char *folder) {
    (void)argument, (void)folder;
    while (pause() != 0) continue;
    return true;
}

static const struct deed deeds[] = {
    {"read", try_read},     {"list", try_list},       {"write", try_write},     {"above", try_above},
    {"rename", try_rename}, {"link", try_link},       {"socket", try_socket},   {"fork", try_fork},
    {"exec", try_exec},     {"trace", try_trace},     {"signal", try_signal},   {"abort", try_abort},
    {"code", try_code},     {"memory", try_memory},   {"unlimit", try_unlimit}, {"time", try_time},
    {"call", try_call},     {"old", try_old},         {"length", try_length},   {"files", try_files},
    {"thread", try_thread}, {"nothing", try_nothing},
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
    if (fscanf(stdin, "# probe %63s %511s", deed, argument) < 1) return 1;
    dprintf(3, "progress %s 0.5 \n", deed);
    try_deed(deed, argument, folder);
    return 65;
}
