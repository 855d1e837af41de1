/* A filter of system calls beside that of runner/seccomp.c, which is put on before exec and so has to let the loader
 * map libraries as executable.  Once main runs nothing is loaded any more, and a hijacked process that writes code into
 * a file of its own, or finds it in its input, can't map it as executable.  prctl goes with it: nothing puts a third
 * filter on.
 *
 * Written by hand, because whittle needs libseccomp for nothing else.  A filter sees the number and the arguments of a
 * call as words of 32 bits in struct seccomp_data; the bits of PROT_EXEC and prctl lie in the lower one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/no_new_code.h"

#include <errno.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <stddef.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>

#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
enum { PROTECTION = offsetof(struct seccomp_data, args) + 2 * 8 };
#else
enum { PROTECTION = offsetof(struct seccomp_data, args) + 2 * 8 + 4 };
#endif

#ifdef SYS_mmap2
enum { MAP = SYS_mmap2 };
#else
enum { MAP = SYS_mmap };
#endif

#define LOAD(offset) BPF_STMT(BPF_LD | BPF_W | BPF_ABS, (offset))
#define GO_TO_IF(number, steps) BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (number), (steps), 0)
#define ANSWER(action) BPF_STMT(BPF_RET | BPF_K, (action))

bool worker_no_new_code(void) {
    struct sock_filter instructions[] = {
        LOAD(offsetof(struct seccomp_data, nr)),
        GO_TO_IF(MAP, 5),
        GO_TO_IF(SYS_mprotect, 4),
        GO_TO_IF(SYS_pkey_mprotect, 3),
        GO_TO_IF(SYS_prctl, 4),
        GO_TO_IF(SYS_seccomp, 3),
        ANSWER(SECCOMP_RET_ALLOW),
        LOAD(PROTECTION),
        BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, PROT_EXEC, 0, 1),
        ANSWER(SECCOMP_RET_ERRNO | EPERM),
        ANSWER(SECCOMP_RET_ALLOW),
    };
    struct sock_fprog program = {.len = sizeof instructions / sizeof *instructions, .filter = instructions};
    return prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program, 0, 0) == 0;
}
