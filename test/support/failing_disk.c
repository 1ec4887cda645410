/* Failing disk, loaded before libc (LD_PRELOAD): each call of a process on files of one folder is counted, and the
 * n-th, or each from the n-th on, fails with an error number. See support/failing_disk.py. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

enum { MOST = 4096 };
static char folder[MOST];
static char ours[MOST];
static long count, first;
static int number, onwards;

/* Begin: fail the call `nth` on files below `path` (0: none) with `error`, and each later one if `all`. */
void failing_disk_arm(const char *path, long nth, int error, int all) {
  strncpy(folder, path, MOST - 1);
  count = 0, first = nth, number = error, onwards = all;
}

long failing_disk_count(void) { return count; }

static int fails(void) {
  ++count;
  if (!first || count < first || (count > first && !onwards)) return 0;
  errno = number;
  return 1;
}

static int below(const char *path) { return folder[0] && path && !strncmp(path, folder, strlen(folder)); }
static int of_ours(int file) { return folder[0] && file >= 0 && file < MOST && ours[file]; }

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define ON_FILE(type, name, parameters, arguments) \
  type name parameters { return of_ours(file) && fails() ? -1 : REAL(name) arguments; }
#define ON_PATH(name, parameters, arguments, path) \
  int name parameters { return below(path) && fails() ? -1 : REAL(name) arguments; }
#define OPEN(name, parameters, arguments, path)            \
  int name parameters {                                    \
    mode_t mode = 0;                                       \
    if (flags & (O_CREAT | O_TMPFILE)) {                   \
      va_list rest;                                        \
      va_start(rest, flags);                               \
      mode = va_arg(rest, mode_t);                         \
      va_end(rest);                                        \
    }                                                      \
    if (below(path) && fails()) return -1;                 \
    int file = REAL(name) arguments;                       \
    if (file >= 0 && file < MOST) ours[file] = below(path); \
    return file;                                           \
  }

OPEN(open, (const char *path, int flags, ...), (path, flags, mode), path)
OPEN(open64, (const char *path, int flags, ...), (path, flags, mode), path)
OPEN(openat, (int at, const char *path, int flags, ...), (at, path, flags, mode), path)
OPEN(openat64, (int at, const char *path, int flags, ...), (at, path, flags, mode), path)
ON_FILE(ssize_t, read, (int file, void *data, size_t size), (file, data, size))
ON_FILE(ssize_t, pread, (int file, void *data, size_t size, off_t at), (file, data, size, at))
ON_FILE(ssize_t, pread64, (int file, void *data, size_t size, off64_t at), (file, data, size, at))
ON_FILE(ssize_t, write, (int file, const void *data, size_t size), (file, data, size))
ON_FILE(ssize_t, pwrite, (int file, const void *data, size_t size, off_t at), (file, data, size, at))
ON_FILE(ssize_t, pwrite64, (int file, const void *data, size_t size, off64_t at), (file, data, size, at))
ON_FILE(int, fsync, (int file), (file))
ON_FILE(int, fdatasync, (int file), (file))
ON_FILE(int, ftruncate, (int file, off_t size), (file, size))
ON_FILE(int, ftruncate64, (int file, off64_t size), (file, size))
ON_PATH(rename, (const char *old, const char *path), (old, path), path)
ON_PATH(unlink, (const char *path), (path), path)
ON_PATH(mkdir, (const char *path, mode_t mode), (path, mode), path)
ON_PATH(symlink, (const char *to, const char *path), (to, path), path)

int close(int file) {
  if (file >= 0 && file < MOST) ours[file] = 0;
  return REAL(close)(file);
}
