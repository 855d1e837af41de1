/* A filter of system calls beside that of runner/seccomp.c, which is put on before exec and so has to let the loader
 * map libraries as executable.  Once main runs nothing is loaded any more, and a hijacked process that writes code into
 * a file of its own, or finds it in its input, can't map it as executable.  prctl goes with it: nothing puts a third
 * filter on.  One request of prctl's stays, to be killed with one's parent: where jobs are not sandboxed, as sanitizers
 * want it, the helper of a leak check makes it, which would else wait for ever for a parent that was killed.
 *
 * Written by hand, because whittle needs libseccomp for nothing else.  A filter sees the number and the arguments of a
 * call as words of 32 bits in struct seccomp_data; all that is looked for lies in the lower one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/no_new_code.h"

#include <errno.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <stddef.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>

#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
enum { LOWER = 0 };
#else
enum { LOWER = 4 };
#endif
#define ARGUMENT(i) (offsetof(struct seccomp_data, args) + (i)*8 + LOWER)

#ifdef SYS_mmap2
enum { MAP = SYS_mmap2 };
#else
enum { MAP = SYS_mmap };
#endif

#define LOAD(offset) BPF_STMT(BPF_LD | BPF_W | BPF_ABS, (offset))
#define GO_TO_IF(number, steps) BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (number), (steps), 0)
#define ANSWER(action) BPF_STMT(BPF_RET | BPF_K, (action))

bool command_no_new_code(void) {
    struct sock_filter instructions[] = {
        LOAD(offsetof(struct seccomp_data, nr)),
        GO_TO_IF(MAP, 5),
        GO_TO_IF(SYS_mprotect, 4),
        GO_TO_IF(SYS_pkey_mprotect, 3),
        GO_TO_IF(SYS_prctl, 4),
        GO_TO_IF(SYS_seccomp, 7),
        ANSWER(SECCOMP_RET_ALLOW),
        LOAD(ARGUMENT(2)),
        BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, PROT_EXEC, 4, 5),
        LOAD(ARGUMENT(0)), /* of prctl */
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, PR_SET_PDEATHSIG, 0, 2),
        LOAD(ARGUMENT(1)),
        GO_TO_IF(SIGKILL, 1),
        ANSWER(SECCOMP_RET_ERRNO | EPERM),
        ANSWER(SECCOMP_RET_ALLOW),
    };
    struct sock_fprog program = {.len = sizeof instructions / sizeof *instructions, .filter = instructions};
    return prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program, 0, 0) == 0;
}
