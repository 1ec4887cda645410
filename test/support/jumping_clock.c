/* Jumping clock, loaded before libc (LD_PRELOAD): the wall clock of a process is ahead by the seconds in the file that
 * JUMPING_CLOCK names, a number of 64 bits that may change at any time. What waits until a time of the wall clock waits
 * longer or shorter then, as where the clock of a computer is set. See test_wall_clock.py. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

typedef struct timespec Time;
static const int64_t SECOND = 1000000000, SLICE = 50000000;
static const volatile int64_t *ahead;
static int (*real)(clockid_t, Time *);

__attribute__((constructor)) static void begin(void) {
  real = dlsym(RTLD_NEXT, "clock_gettime");
  const char *path = getenv("JUMPING_CLOCK");
  int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
  void *map = file < 0 ? MAP_FAILED : mmap(0, sizeof *ahead, PROT_READ, MAP_SHARED, file, 0);
  if (file >= 0) close(file);
  if (map != MAP_FAILED) ahead = map;
}

int clock_gettime(clockid_t clock, Time *now) {
  if (!real) begin();
  int done = real(clock, now);
  if (!done && ahead && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) now->tv_sec += *ahead;
  return done;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
  Time time;
  clock_gettime(CLOCK_REALTIME, &time);
  now->tv_sec = time.tv_sec, now->tv_usec = time.tv_nsec / 1000;
  return 0;
}

time_t time(time_t *now) {
  Time time;
  clock_gettime(CLOCK_REALTIME, &time);
  return now ? (*now = time.tv_sec) : time.tv_sec;
}

/* Time until a wall time [ns], and the end of the next slice of it by the steady clock. */
static int64_t slice(const Time *until, Time *end) {
  Time now;
  clock_gettime(CLOCK_REALTIME, &now);
  int64_t left = (until->tv_sec - now.tv_sec) * SECOND + until->tv_nsec - now.tv_nsec;
  clock_gettime(CLOCK_MONOTONIC, end);
  int64_t nanoseconds = end->tv_nsec + (left < 0 ? 0 : left < SLICE ? left : SLICE);
  end->tv_sec += nanoseconds / SECOND, end->tv_nsec = nanoseconds % SECOND;
  return left;
}

/* A wait that is not over is woken without a reason at the end of a slice, as POSIX allows it. */
int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           const Time *restrict until) {
  if (condition->__data.__wrefs & 2) return pthread_cond_clockwait(condition, mutex, CLOCK_MONOTONIC, until);
  Time end;
  int64_t left = slice(until, &end);
  int done = pthread_cond_clockwait(condition, mutex, CLOCK_MONOTONIC, &end);
  return done == ETIMEDOUT && left > SLICE ? 0 : done;
}

int pthread_mutex_timedlock(pthread_mutex_t *restrict mutex, const Time *restrict until) {
  for (;;) {
    Time end;
    int64_t left = slice(until, &end);
    int done = pthread_mutex_clocklock(mutex, CLOCK_MONOTONIC, &end);
    if (done != ETIMEDOUT || left <= SLICE) return done;
  }
}

int sem_timedwait(sem_t *restrict semaphore, const Time *restrict until) {
  for (;;) {
    Time end;
    int64_t left = slice(until, &end);
    int done = sem_clockwait(semaphore, CLOCK_MONOTONIC, &end);
    if (!done || errno != ETIMEDOUT || left <= SLICE) return done;
  }
}
