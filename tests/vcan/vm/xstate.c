/* Loaded before user-mode Linux on processors with AMX, where its kernel (6.1) cannot start a process by itself.
 *
 * It keeps the floating-point and vector registers of a process in a buffer that ends before AMX' tiles. The machine's kernel gives
 * it that much when asked (PTRACE_GETREGSET), but takes back nothing but a whole state (PTRACE_SETREGSET: EFAULT). So the state is
 * filled up here, with tiles that are not in use; no guest can use them, since they must be asked for and are not handed on.
 */
#include <errno.h>
#include <linux/elf.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum { HEADER = 512, MOST = 1 << 16 };
static const uint64_t BEFORE_THE_TILES = 0x3ff; /* x87 to PKRU, bits 0 to 9 of XSTATE_BV */

static _Alignas(64) unsigned char whole[MOST]; /* its kernel threads have small stacks, and only one runs at a time */

long ptrace(enum __ptrace_request request, ...)
{
    va_list list;
    va_start(list, request);
    pid_t pid = va_arg(list, pid_t);
    void *address = va_arg(list, void *);
    void *data = va_arg(list, void *);
    va_end(list);

    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) { /* the C library's convention */
        long word = 0;
        return syscall(SYS_ptrace, (long)request, (long)pid, address, &word) == -1 ? -1 : (errno = 0, word);
    }
    long result = syscall(SYS_ptrace, (long)request, (long)pid, address, data);
    if (result != -1 || errno != EFAULT || request != PTRACE_SETREGSET || (uintptr_t)address != NT_X86_XSTATE)
        return result;

    const struct iovec *given = data;
    struct iovec filled = { whole, MOST };
    if (given->iov_len < HEADER + sizeof(uint64_t) || given->iov_len > MOST)
        return result;
    if (syscall(SYS_ptrace, (long)PTRACE_GETREGSET, (long)pid, address, &filled) == -1) /* how long a whole state is */
        return -1;
    if (filled.iov_len < given->iov_len)
        return result;
    memset(whole, 0, filled.iov_len);
    memcpy(whole, given->iov_base, given->iov_len);
    uint64_t present;
    memcpy(&present, whole + HEADER, sizeof present);
    present &= BEFORE_THE_TILES;
    memcpy(whole + HEADER, &present, sizeof present);
    return syscall(SYS_ptrace, (long)request, (long)pid, address, &filled);
}
