/* A disk that stalls, for a program that is started with LD_PRELOAD of this: writing to a recording and syncing it
 * waits while the file that DISK_STALLS names exists, and so does the return from the removal of a directory. */

#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <stdio.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

static void wait_until_it_answers(void) {
    const char *stalls = getenv("DISK_STALLS");
    while (stalls != NULL && access(stalls, F_OK) == 0) {
        usleep(1000);
    }
}

static void wait_for_the_disk(int descriptor) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, sizeof path);
    if (length < 5 || strncmp(path + length - 5, ".mcap", 5) != 0) {
        return;
    }
    wait_until_it_answers();
}

int rmdir(const char *path) {
    int result = syscall(SYS_unlinkat, AT_FDCWD, path, AT_REMOVEDIR);
    wait_until_it_answers();
    return result;
}

ssize_t write(int descriptor, const void *bytes, size_t count) {
    /* What wakes a thread has 8 bytes. */
    if (count > 8) {
        wait_for_the_disk(descriptor);
    }
    return syscall(SYS_write, descriptor, bytes, count);
}

int fdatasync(int descriptor) {
    wait_for_the_disk(descriptor);
    return syscall(SYS_fdatasync, descriptor);
}
