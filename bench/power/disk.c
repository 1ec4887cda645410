/* A disk that forgets: what processes have synchronised below the folder DISK_OF is kept a second time in DISK_KEEPS.
 *
 * Of a file its content at its last fsync or fdatasync is kept, under the number of its inode; of a folder likewise,
 * a line for each name: "f" or "d", and its number. Nothing else is there after a loss of power, unless by chance.
 * Files get a second name in DISK_KEEPS: as long as it is there, no other file gets their number.
 * Built and preloaded by bench/power/disk.py.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static pthread_mutex_t one_at_a_time = PTHREAD_MUTEX_INITIALIZER;

static void fail(const char *what) {
    perror(what);
    abort();
}

/* Gives a file a name more; there is nothing to do where it has that already, or none any more. */
static void hold(int folder, const char *name, int flags, const char *keeps, ino_t number) {
    char held[PATH_MAX];
    snprintf(held, sizeof held, "%s/held.%lu", keeps, (unsigned long)number);
    if (linkat(folder, name, AT_FDCWD, held, flags) != 0 && errno != EEXIST && errno != ENOENT) fail(held);
}

/* Writes the content of an open file, or the names in a folder, to a file that is renamed when it is whole. */
static void keep(int fd, const char *of, const char *keeps) {
    char link[64], path[PATH_MAX], draft[PATH_MAX], whole[PATH_MAX];
    struct stat about;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0 || fstat(fd, &about) != 0) fail("disk: what was synchronised");
    path[length] = 0;
    size_t root = strlen(of);
    if (strncmp(path, of, root) != 0 || (path[root] != 0 && path[root] != '/')) return;
    snprintf(draft, sizeof draft, "%s/draft.%d", keeps, (int)getpid());
    snprintf(whole, sizeof whole, "%s/%lu", keeps, (unsigned long)about.st_ino);
    FILE *out = fopen(draft, "w");
    if (out == NULL) fail(draft);
    if (S_ISDIR(about.st_mode)) {
        DIR *folder = opendir(path);
        if (folder == NULL) fail(path);
        for (struct dirent *entry; (entry = readdir(folder)) != NULL;) {
            const char *name = entry->d_name;
            if (strcmp(name, ".") == 0 || strcmp(name, "..") == 0) continue;
            if (entry->d_type == DT_REG) hold(dirfd(folder), name, 0, keeps, entry->d_ino);
            fprintf(out, "%c %lu %s\n", entry->d_type == DT_DIR ? 'd' : 'f', (unsigned long)entry->d_ino, name);
        }
        closedir(folder);
    } else {
        hold(AT_FDCWD, link, AT_SYMLINK_FOLLOW, keeps, about.st_ino);
        char block[1 << 16];
        ssize_t got;
        int in = open(link, O_RDONLY | O_CLOEXEC); /* it may be open for writing only */
        if (in < 0) fail(path);
        while ((got = read(in, block, sizeof block)) > 0)
            if (fwrite(block, 1, (size_t)got, out) != (size_t)got) fail(draft);
        if (got < 0) fail(path);
        close(in);
    }
    if (fclose(out) != 0 || rename(draft, whole) != 0) fail(whole);
}

static int synchronised(const char *function, int fd) {
    int (*really)(int) = (int (*)(int))dlsym(RTLD_NEXT, function);
    const char *of = getenv("DISK_OF"), *keeps = getenv("DISK_KEEPS");
    int result = really(fd);
    if (result == 0 && of != NULL && keeps != NULL) {
        pthread_mutex_lock(&one_at_a_time);
        keep(fd, of, keeps);
        pthread_mutex_unlock(&one_at_a_time);
    }
    return result;
}

int fsync(int fd) { return synchronised("fsync", fd); }

int fdatasync(int fd) { return synchronised("fdatasync", fd); }
