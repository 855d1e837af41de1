/* Ends by SIGBUS, with the name of the file.
 *
 * Nothing is known of what the thread was at, so the handler says by itself what there is to say, and ends.  Which file
 * has the address stands in /proc/self/maps, a line of which is
 *
 *     7f2c1a000000-7f2c1a400000 r--p 00000000 fe:00 1234      /path/of/the/file
 *
 * and is read byte by byte, with what signal handlers may call alone.  A path may have line ends; they are written as
 * \012 there, and so here.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/cut_input.h"

#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <unistd.h>

#include "server/shared/worker_protocol.h"

enum { LINE_BYTES = PATH_MAX + 128 };

/* The hexadecimal number at *at, which is moved on behind it and the byte that ends it. */
static uintptr_t take_address(const char **at) {
    uintptr_t value = 0;
    for (; **at; ++*at) {
        char c = **at;
        bool is_digit = c >= '0' && c <= '9';
        if (!is_digit && (c < 'a' || c > 'f')) break;
        value = value << 4 | (uintptr_t)(is_digit ? c - '0' : c - 'a' + 10);
    }
    if (**at) ++*at;
    return value;
}

/* The path of a line's file where its range has the address, else NULL. */
static const char *path_if_it_has(const char *line, uintptr_t address) {
    uintptr_t begin = take_address(&line), end = take_address(&line);
    return address >= begin && address < end ? strchr(line, '/') : NULL;
}

static int next_byte(int fd) {
    static char piece[4096];
    static ssize_t at, n;
    if (at == n) {
        at = 0;
        n = read(fd, piece, sizeof piece);
    }
    return n > 0 ? (unsigned char)piece[at++] : -1;
}

/* The file that is mapped at the address; NULL where that can't be known. */
static const char *file_at(uintptr_t address) {
    static char line[LINE_BYTES];
    const char *found = NULL;
    size_t n = 0;
    int c = 0, fd = open("/proc/self/maps", O_RDONLY | O_CLOEXEC);
    while (fd >= 0 && !found && c >= 0) {
        c = next_byte(fd);
        if (c >= 0 && c != '\n') {
            if (n < sizeof line - 1) line[n++] = (char)c;
            continue;
        }
        line[n] = '\0';
        n = 0;
        found = path_if_it_has(line, address);
    }
    if (fd >= 0) close(fd);
    return found;
}

static void tell(const char *text) {
    ssize_t told = write(STDERR_FILENO, text, strlen(text));
    (void)told;
}

/* Of several threads that are at it the first one tells. */
static _Noreturn void end_of_cut_input(int signal, siginfo_t *about, void *context) {
    static atomic_flag is_told = ATOMIC_FLAG_INIT;
    (void)signal, (void)context;
    while (atomic_flag_test_and_set(&is_told)) pause();
    const char *file = file_at((uintptr_t)about->si_addr);
    tell("whittle: ");
    tell(file ? file : "a file");
    tell(" was cut short, or its disk failed, while it was read\n");
    _exit(WIRE_EXIT_IO);
}

void cut_input_watch(void) {
    struct sigaction action = {.sa_sigaction = end_of_cut_input, .sa_flags = SA_SIGINFO};
    sigemptyset(&action.sa_mask);
    sigaction(SIGBUS, &action, NULL);
}
