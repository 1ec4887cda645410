/* Failing disk, loaded before libc (LD_PRELOAD): each call of a process on files of one folder is counted, and the
 * n-th, or each from the n-th on, fails with an error number. Likewise one allocation of memory, of any library. See
 * support/failing_disk.py. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/types.h>
#include <time.h>
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

static long allocations, last;

/* Fail the allocation `nth` from now (0: none). */
void failing_memory_arm(long nth) { allocations = 0, last = nth; }

long failing_memory_count(void) { return allocations; }

#define ALLOCATION(name, parameters, arguments) \
  extern void *__libc_##name parameters;        \
  void *name parameters {                       \
    if (++allocations != last) return __libc_##name arguments; \
    errno = ENOMEM;                             \
    return NULL;                                \
  }

ALLOCATION(malloc, (size_t size), (size))
ALLOCATION(calloc, (size_t number, size_t size), (number, size))
ALLOCATION(realloc, (void *old, size_t size), (old, size))

static int fails(void) {
  ++count;
  if (!first || count < first || (count > first && !onwards)) return 0;
  errno = number;
  return 1;
}

/* Who waits for a lock, as SQLite does where a lock fails, has waited at once. */
int usleep(useconds_t time) { return 0; }
int nanosleep(const struct timespec *time, struct timespec *left) { return 0; }

static int below(const char *path) { return folder[0] && path && !strncmp(path, folder, strlen(folder)); }
static int of_ours(int file) { return folder[0] && file >= 0 && file < MOST && ours[file]; }

/* Whether a call gives a lock back, for which no disk is asked: SQLite would not know its own lock afterwards. */
static int unlocks(unsigned long what, const struct flock *lock) { return what == F_SETLK && lock->l_type == F_UNLCK; }

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define ON_FILE(type, name, parameters, arguments) \
  type name parameters { return of_ours(file) && fails() ? -1 : REAL(name) arguments; }
#define ON_PATH(name, parameters, arguments, path) \
  int name parameters { return below(path) && fails() ? -1 : REAL(name) arguments; }
#define WITH_ARGUMENT(name, number)                                    \
  int name(int file, number what, ...) {                               \
    va_list rest;                                                      \
    va_start(rest, what);                                              \
    void *argument = va_arg(rest, void *);                             \
    va_end(rest);                                                      \
    return of_ours(file) && !unlocks(what, argument) && fails() ? -1 : REAL(name)(file, what, argument); \
  }
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
ON_PATH(stat, (const char *path, struct stat *told), (path, told), path)
ON_PATH(stat64, (const char *path, struct stat64 *told), (path, told), path)
ON_PATH(lstat, (const char *path, struct stat *told), (path, told), path)
ON_PATH(lstat64, (const char *path, struct stat64 *told), (path, told), path)
ON_PATH(fstatat, (int at, const char *path, struct stat *told, int flags), (at, path, told, flags), path)
ON_PATH(fstatat64, (int at, const char *path, struct stat64 *told, int flags), (at, path, told, flags), path)
ON_PATH(statvfs, (const char *path, struct statvfs *told), (path, told), path)
ON_PATH(statvfs64, (const char *path, struct statvfs64 *told), (path, told), path)
ON_FILE(int, fstat, (int file, struct stat *told), (file, told))
ON_FILE(int, fstat64, (int file, struct stat64 *told), (file, told))
ON_FILE(int, fstatvfs, (int file, struct statvfs *told), (file, told))
ON_FILE(int, fstatvfs64, (int file, struct statvfs64 *told), (file, told))
ON_FILE(int, fchmod, (int file, mode_t mode), (file, mode))
ON_FILE(int, fchown, (int file, uid_t user, gid_t group), (file, user, group))
ON_FILE(int, flock, (int file, int how), (file, how))
ON_FILE(off_t, lseek, (int file, off_t to, int from), (file, to, from))
ON_FILE(off64_t, lseek64, (int file, off64_t to, int from), (file, to, from))
WITH_ARGUMENT(fcntl, int)
WITH_ARGUMENT(fcntl64, int)
WITH_ARGUMENT(ioctl, unsigned long)

void *mmap(void *at, size_t size, int use, int how, int file, off_t from) {
  return of_ours(file) && fails() ? MAP_FAILED : REAL(mmap)(at, size, use, how, file, from);
}
void *mmap64(void *at, size_t size, int use, int how, int file, off64_t from) {
  return of_ours(file) && fails() ? MAP_FAILED : REAL(mmap64)(at, size, use, how, file, from);
}

DIR *opendir(const char *path) {
  if (below(path) && fails()) return NULL;
  DIR *entries = REAL(opendir)(path);
  if (entries && dirfd(entries) < MOST) ours[dirfd(entries)] = below(path);
  return entries;
}
int closedir(DIR *entries) {
  ours[dirfd(entries)] = 0;
  return REAL(closedir)(entries);
}
DIR *fdopendir(int file) { return of_ours(file) && fails() ? NULL : REAL(fdopendir)(file); }
struct dirent *readdir(DIR *entries) { return of_ours(dirfd(entries)) && fails() ? NULL : REAL(readdir)(entries); }
struct dirent64 *readdir64(DIR *entries) {
  return of_ours(dirfd(entries)) && fails() ? NULL : REAL(readdir64)(entries);
}

/* A file is closed also where that is told as failed. */
int close(int file) {
  int failed = of_ours(file) && fails();
  if (file >= 0 && file < MOST) ours[file] = 0;
  int done = REAL(close)(file);
  if (failed) errno = number;
  return failed ? -1 : done;
}
