/* Preloaded into a process, a disk with faults for files below SICK_DISK_ROOT, switched by files in the folder SICK_DISK_SWITCHES:

   fsync N   the next N fsync of files return EIO, and every byte since the last successful fsync of the file is lost (read as zero),
             as when the kernel drops dirty pages after a failed writeback; the next fsync succeeds
   folder N  the next N fsync of folders return EIO
   write N   the next N writes return EIO
   full N    the next N writes return ENOSPC

   cc -shared -fPIC -O1 -o sick_disk.so sick_disk.c */

#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

static struct { ino_t inode; off_t synced; } files[4096];

/* Use a switch one time; 0 if it is off. */
static int used(const char *name) {
    char path[4096], text[32] = "";
    const char *folder = getenv("SICK_DISK_SWITCHES");
    if (folder == NULL) return 0;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    long fd = syscall(SYS_openat, AT_FDCWD, path, O_RDWR);
    if (fd < 0) return 0;
    long length = syscall(SYS_read, fd, text, sizeof text - 1);
    int remaining = length > 0 ? atoi(text) : 0;
    if (remaining > 0) {
        length = snprintf(text, sizeof text, "%d        ", remaining - 1);
        syscall(SYS_pwrite64, fd, text, length, 0);
    }
    syscall(SYS_close, fd);
    return remaining > 0;
}

static int is_below_root(int fd) {
    char link[64], path[4096];
    const char *root = getenv("SICK_DISK_ROOT");
    if (root == NULL || fd < 0) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length <= 0) return 0;
    path[length] = 0;
    return strncmp(path, root, strlen(root)) == 0;
}

static void discard(int fd, off_t from, off_t to) {
    static const char zeros[65536];
    while (from < to) {
        size_t count = to - from < (off_t)sizeof zeros ? (size_t)(to - from) : sizeof zeros;
        if (syscall(SYS_pwrite64, fd, zeros, count, from) <= 0) return;
        from += count;
    }
}

int fsync(int fd) {
    struct stat state;
    if (!is_below_root(fd) || fstat(fd, &state) != 0) return syscall(SYS_fsync, fd);
    if (S_ISDIR(state.st_mode)) {
        if (used("folder")) { errno = EIO; return -1; }
        return syscall(SYS_fsync, fd);
    }
    if (!S_ISREG(state.st_mode) || fd >= 4096) return syscall(SYS_fsync, fd);
    if (files[fd].inode != state.st_ino) { files[fd].inode = state.st_ino; files[fd].synced = 0; }
    if (used("fsync")) {
        discard(fd, files[fd].synced, state.st_size);
        errno = EIO;
        return -1;
    }
    int result = syscall(SYS_fsync, fd);
    if (result == 0) files[fd].synced = state.st_size;
    return result;
}

static int fails(int fd) {
    struct stat state;
    if (!is_below_root(fd) || fstat(fd, &state) != 0 || !S_ISREG(state.st_mode)) return 0;
    errno = used("write") ? EIO : used("full") ? ENOSPC : 0;
    return errno != 0;
}

ssize_t write(int fd, const void *data, size_t count) {
    return fails(fd) ? -1 : syscall(SYS_write, fd, data, count);
}

ssize_t writev(int fd, const struct iovec *pieces, int count) {
    return fails(fd) ? -1 : syscall(SYS_writev, fd, pieces, count);
}
