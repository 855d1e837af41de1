/* run_measured SECONDS BYTES PROGRAM [ARGUMENT ...]: runs a program with limits of processor time and address space,
 * and says on standard output what it took: processor seconds, peak of resident bytes, exit status (minus the signal
 * where one ended it).  A peak counts from fork on, so what starts the program has to be as small as this is.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

static double seconds_of(struct timeval t) { return (double)t.tv_sec + 1e-6 * (double)t.tv_usec; }

static int limit(unsigned resource, const char *text) {
    rlim_t most = (rlim_t)strtoull(text, NULL, 10);
    return setrlimit(resource, &(struct rlimit){most, most});
}

static void become(char **argv) {
    int nowhere = open("/dev/null", O_WRONLY);
    if (nowhere < 0 || dup2(nowhere, STDOUT_FILENO) < 0) return;
    if (limit(RLIMIT_CPU, argv[1]) || limit(RLIMIT_AS, argv[2])) return;
    execv(argv[3], &argv[3]);
}

int main(int argc, char **argv) {
    if (argc < 4) {
        fprintf(stderr, "run_measured SECONDS BYTES PROGRAM [ARGUMENT ...]\n");
        return 2;
    }
    pid_t child = fork();
    if (child == 0) {
        become(argv);
        _exit(127);
    }
    int how;
    struct rusage usage;
    if (child < 0 || wait4(child, &how, 0, &usage) != child) return 2;
    printf("%.6f %ld %d\n", seconds_of(usage.ru_utime) + seconds_of(usage.ru_stime), usage.ru_maxrss * 1024,
           WIFEXITED(how) ? WEXITSTATUS(how) : -WTERMSIG(how));
    return 0;
}
