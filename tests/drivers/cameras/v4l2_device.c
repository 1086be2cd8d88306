/* A V4L2 capture device in user space: loaded with LD_PRELOAD, it answers for the path in
 * FAKE_VIDEO, so that OpenCV's own V4L2 code runs against it. It offers YUYV, GREY, mosaics of 8 and
 * 10 bit and MJPG (the JPEGs 0.jpg and 1.jpg of the folder FAKE_FOLDER, in turns) at 640x480 and
 * 1280x720, with 30 or 15 frames a second. Files in that
 * folder switch it: `gone` is unplugged, `silent` sends nothing, `damaged` cuts each second JPEG. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#define MOST 8
#define NEXT(name) ((typeof(&name))dlsym(RTLD_NEXT, #name))
#define MODE(last) va_list rest; va_start(rest, last); int mode = va_arg(rest, int); va_end(rest)

static char ours[1024]; /* by descriptor: a timer that is readable once per frame */
static int owner = -1, rate = 30, frames, waiting, queue[MOST];
static const unsigned offers[] = {
    V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_GREY, V4L2_PIX_FMT_MJPEG, V4L2_PIX_FMT_SRGGB8,
    V4L2_PIX_FMT_SRGGB10,
};
#define OFFERS (sizeof offers / sizeof *offers)
static unsigned format = V4L2_PIX_FMT_YUYV, width = 640, height = 480;
static unsigned char *memory[MOST], jpeg[2][1 << 20];
static size_t jpeg_bytes[2];

static int is(const char *name)
{
    char path[512];
    snprintf(path, sizeof path, "%s/%s", getenv("FAKE_FOLDER"), name);
    return access(path, F_OK) == 0;
}

static int fails(int code) { errno = code; return -1; }

static int known(int fd) { return fd >= 0 && fd < (int)sizeof ours && ours[fd]; }

static int named(const char *path) { return path && !strcmp(path, getenv("FAKE_VIDEO")); }

static int opened(void)
{
    if (is("gone")) return fails(ENOENT);
    int fd = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    if (fd >= 0 && fd < (int)sizeof ours) ours[fd] = 1;
    return fd;
}

int open(const char *path, int flags, ...)
{
    MODE(flags);
    return named(path) ? opened() : NEXT(open)(path, flags, mode);
}

int open64(const char *path, int flags, ...)
{
    MODE(flags);
    return named(path) ? opened() : NEXT(open64)(path, flags, mode);
}

int close(int fd)
{
    if (known(fd)) ours[fd] = 0;
    if (fd >= 0 && fd == owner) owner = -1;
    return NEXT(close)(fd);
}

int fstat(int fd, struct stat *found)
{
    int result = NEXT(fstat)(fd, found);
    if (known(fd)) found->st_mode = S_IFCHR | 0660;
    return result;
}

int fstat64(int fd, struct stat64 *found)
{
    int result = NEXT(fstat64)(fd, found);
    if (known(fd)) found->st_mode = S_IFCHR | 0660;
    return result;
}

static void *mapped(size_t bytes, off_t place)
{
    int rights = PROT_READ | PROT_WRITE, kind = MAP_PRIVATE | MAP_ANONYMOUS;
    return memory[place / 4096 % MOST] = NEXT(mmap)(NULL, bytes, rights, kind, -1, 0);
}

void *mmap(void *at, size_t bytes, int rights, int kind, int fd, off_t place)
{
    return known(fd) ? mapped(bytes, place) : NEXT(mmap)(at, bytes, rights, kind, fd, place);
}

void *mmap64(void *at, size_t bytes, int rights, int kind, int fd, off_t place)
{
    return known(fd) ? mapped(bytes, place) : NEXT(mmap64)(at, bytes, rights, kind, fd, place);
}

int poll(struct pollfd *list, nfds_t count, int limit_ms)
{
    if (count == 1 && known(list->fd) && is("gone")) {
        list->revents = POLLERR | POLLHUP;
        return 1;
    }
    if (count == 1 && known(list->fd) && is("silent")) {
        usleep(limit_ms * 1000);
        list->revents = 0;
        return 0;
    }
    return NEXT(poll)(list, count, limit_ms);
}

static void describe(struct v4l2_capability *out)
{
    memset(out, 0, sizeof *out);
    strcpy((char *)out->driver, "fake");
    strcpy((char *)out->card, "Fake Camera");
    out->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
    out->capabilities = out->device_caps | V4L2_CAP_DEVICE_CAPS;
}

static void choose(const struct v4l2_pix_format *asked)
{
    format = V4L2_PIX_FMT_YUYV;
    for (size_t k = 0; k < OFFERS; k++)
        if (asked->pixelformat == offers[k]) format = offers[k];
    width = asked->width >= 1280 ? 1280 : 640;
    height = asked->width >= 1280 ? 720 : 480;
}

static unsigned bytes_of_pixel(void)
{
    return format == V4L2_PIX_FMT_YUYV || format == V4L2_PIX_FMT_SRGGB10 ? 2 : 1;
}

static int list_format(struct v4l2_fmtdesc *out)
{
    if (out->index >= OFFERS) return fails(EINVAL);
    out->pixelformat = offers[out->index];
    return 0;
}

static int list_size(struct v4l2_frmsizeenum *out)
{
    if (out->index > 1) return fails(EINVAL);
    out->type = V4L2_FRMSIZE_TYPE_DISCRETE;
    out->discrete.width = out->index ? 1280 : 640;
    out->discrete.height = out->index ? 720 : 480;
    return 0;
}

static int list_interval(struct v4l2_frmivalenum *out)
{
    if (out->index > 1) return fails(EINVAL);
    out->type = V4L2_FRMIVAL_TYPE_DISCRETE;
    out->discrete.numerator = 1;
    out->discrete.denominator = out->index ? 15 : 30;
    return 0;
}

/* red 200, green 100, blue 50 and the number of the frame, times 4 in 10 bits */
static void fill_mosaic(unsigned char *out)
{
    unsigned short *wide = (unsigned short *)out;
    for (size_t k = 0; k < (size_t)width * height; k++) {
        unsigned column = k % width & 1, row = k / width & 1;
        unsigned level = (column && row ? 50 : column || row ? 100 : 200) + frames % 50;
        if (format == V4L2_PIX_FMT_SRGGB8) out[k] = level;
        else wide[k] = level * 4;
    }
}

static void tell(struct v4l2_pix_format *out)
{
    out->width = width;
    out->height = height;
    out->pixelformat = format;
    out->bytesperline = format == V4L2_PIX_FMT_MJPEG ? 0 : bytes_of_pixel() * width;
    out->sizeimage = width * height * 2;
    out->field = V4L2_FIELD_NONE;
}

static unsigned photograph(unsigned char *out)
{
    int turn = frames & 1;
    if (format == V4L2_PIX_FMT_SRGGB8 || format == V4L2_PIX_FMT_SRGGB10) {
        fill_mosaic(out);
        return width * height * bytes_of_pixel();
    }
    if (format != V4L2_PIX_FMT_MJPEG) {
        for (size_t k = 0; k < (size_t)width * height * 2; k += 2) {
            out[k] = frames * 7 + k / 64;
            out[k + 1] = 128;
        }
        return width * height * bytes_of_pixel();
    }
    if (!jpeg_bytes[turn]) {
        char path[512];
        snprintf(path, sizeof path, "%s/%d.jpg", getenv("FAKE_FOLDER"), turn);
        FILE *file = fopen(path, "r");
        jpeg_bytes[turn] = fread(jpeg[turn], 1, sizeof jpeg[turn], file);
        fclose(file);
    }
    memcpy(out, jpeg[turn], jpeg_bytes[turn]);
    return turn && is("damaged") ? jpeg_bytes[turn] / 2 : jpeg_bytes[turn];
}

static int dequeue(int fd, struct v4l2_buffer *out)
{
    unsigned long long due;
    struct timespec now;
    /* what `poll` announced comes: `silent` may be set between both */
    if (!waiting || read(fd, &due, sizeof due) != sizeof due) return fails(EAGAIN);
    out->index = queue[0];
    memmove(queue, queue + 1, --waiting * sizeof *queue);
    out->length = width * height * 2;
    out->bytesused = photograph(memory[out->index]);
    out->sequence = frames++;
    clock_gettime(CLOCK_MONOTONIC, &now);
    out->timestamp.tv_sec = now.tv_sec;
    out->timestamp.tv_usec = now.tv_nsec / 1000;
    return 0;
}

static int stream(int fd, int on)
{
    struct timespec period = {0, on ? 1000000000 / rate : 0};
    struct itimerspec timer = {period, period};
    if (!on) waiting = 0;
    return timerfd_settime(fd, 0, &timer, NULL);
}

static int answer(int fd, unsigned request, void *argument)
{
    struct v4l2_fract *period;
    struct v4l2_format *shape = argument;
    struct v4l2_buffer *buffer = argument;
    struct v4l2_requestbuffers *buffers = argument;
    int busy = owner >= 0 && owner != fd;
    if (is("gone")) return fails(ENODEV);
    switch (request) {
    case VIDIOC_QUERYCAP: describe(argument); return 0;
    case VIDIOC_ENUM_FMT: return list_format(argument);
    case VIDIOC_ENUM_FRAMESIZES: return list_size(argument);
    case VIDIOC_ENUM_FRAMEINTERVALS: return list_interval(argument);
    case VIDIOC_S_FMT:
        if (busy) return fails(EBUSY);
        choose(&shape->fmt.pix); /* fall through */
    case VIDIOC_G_FMT: tell(&shape->fmt.pix); return 0;
    case VIDIOC_S_PARM:
        period = &((struct v4l2_streamparm *)argument)->parm.capture.timeperframe;
        rate = period->numerator ? period->denominator / period->numerator : 30;
        if (rate < 1 || rate > 60) rate = 30; /* fall through */
    case VIDIOC_G_PARM:
        period = &((struct v4l2_streamparm *)argument)->parm.capture.timeperframe;
        period->numerator = 1;
        period->denominator = rate;
        return 0;
    case VIDIOC_REQBUFS:
        if (busy) return fails(EBUSY);
        if (buffers->count > MOST) buffers->count = MOST;
        owner = buffers->count ? fd : -1;
        waiting = 0;
        return 0;
    case VIDIOC_QUERYBUF:
        buffer->length = width * height * 2;
        buffer->m.offset = buffer->index * 4096;
        return 0;
    case VIDIOC_QBUF: if (waiting < MOST) queue[waiting++] = buffer->index; return 0;
    case VIDIOC_DQBUF: return dequeue(fd, buffer);
    case VIDIOC_STREAMON: return stream(fd, 1);
    case VIDIOC_STREAMOFF: return stream(fd, 0);
    default: return fails(EINVAL);
    }
}

int ioctl(int fd, unsigned long request, ...)
{
    va_list rest;
    va_start(rest, request);
    void *argument = va_arg(rest, void *);
    va_end(rest);
    return known(fd) ? answer(fd, request, argument) : NEXT(ioctl)(fd, request, argument);
}
