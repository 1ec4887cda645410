/* A disk that forgets: what a process has synchronised below the folder DISK_OF is kept a second time in DISK_KEEPS.
 *
 * Of a file its content at its last fsync or fdatasync is kept, under the number of its inode; of a folder, under
 * "names", which name belongs to which number. Nothing else is there after a loss of power, unless by chance.
 * Built and preloaded by bench/dom/power.py.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
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

/* Writes the content of an open file, or the names in a folder, to a file that is renamed when it is whole. */
static void keep(int fd, const char *of, const char *keeps) {
    char link[64], path[PATH_MAX], draft[PATH_MAX], whole[PATH_MAX];
    struct stat about;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0 || fstat(fd, &about) != 0) fail("disk: what was synchronised");
    path[length] = 0;
    if (strncmp(path, of, strlen(of)) != 0) return;
    snprintf(draft, sizeof draft, "%s/draft", keeps);
    FILE *out = fopen(draft, "w");
    if (out == NULL) fail(draft);
    if (S_ISDIR(about.st_mode)) {
        DIR *folder = opendir(path);
        if (folder == NULL) fail(path);
        for (struct dirent *entry; (entry = readdir(folder)) != NULL;)
            if (entry->d_type == DT_REG) fprintf(out, "%lu %s\n", (unsigned long)entry->d_ino, entry->d_name);
        closedir(folder);
        snprintf(whole, sizeof whole, "%s/names", keeps);
    } else {
        char block[1 << 16];
        ssize_t got;
        for (off_t at = 0; (got = pread(fd, block, sizeof block, at)) > 0; at += got)
            if (fwrite(block, 1, (size_t)got, out) != (size_t)got) fail(draft);
        if (got < 0) fail(path);
        snprintf(whole, sizeof whole, "%s/%lu", keeps, (unsigned long)about.st_ino);
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
