/* A board without hardware: serves the protocol on a pseudo terminal whose name it prints, until its standard input ends.
 *
 *     posix_board [-s FRAME_BYTES] [-c CHANNELS] [-r RATE_HZ] [-f]
 *
 * A timer's signal stands for the conversion interrupt; it may come anywhere in the main loop, as on a board. With -f frames are
 * converted when they are read, as fast as the host takes them. All channels follow the drive signal of 5 Hz: about what a probe
 * of examples/scene.toml gives at 10 mN, behind amplifiers of 1 nF and a force sensor of 0.1 V/N.
 */
#define _XOPEN_SOURCE 700

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/time.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "drive.h"
#include "probe_board.h"

#define HIGHEST_RATE_MHZ 100000000u /* 100 kS/s */
enum { DRIVE_FREQUENCY_MHZ = 5000, DRIVE_AMPLITUDE = 20000, TICK_US = 1000 };

static uint8_t memory[PROBE_BUFFER_BYTES(3, PROBE_MIN_FRAME, HIGHEST_RATE_MHZ)]; /* the largest of all sizes and channels */
static probe_board board;
static probe_drive drive;
static volatile sig_atomic_t is_converting;
static bool is_fast;
static struct timespec started;
static uint64_t converted;

static void convert(void)
{
    const int16_t value = probe_drive_next(&drive);
    const int16_t codes[PROBE_MAX_CHANNELS] = {(int16_t)(value * 27 / 40), value, value};
    probe_convert(&board, codes, 0);
    converted++;
}

static void on_tick(int number)
{
    (void)number;
    struct timespec now;
    if (!is_converting || is_fast || clock_gettime(CLOCK_MONOTONIC, &now) != 0)
        return;
    const int64_t elapsed = (int64_t)(now.tv_sec - started.tv_sec) * 1000000 + (now.tv_nsec - started.tv_nsec) / 1000;
    const uint64_t due = (uint64_t)elapsed * board.config.rate_mhz / 1000000000u;
    while (converted < due)
        convert();
}

static void start(void *context)
{
    (void)context;
    drive.phase = 0;
    (void)probe_drive_set(&drive, DRIVE_FREQUENCY_MHZ, board.config.rate_mhz, DRIVE_AMPLITUDE);
    converted = 0;
    (void)clock_gettime(CLOCK_MONOTONIC, &started);
    is_converting = 1;
}

static void stop(void *context)
{
    (void)context;
    is_converting = 0; /* a signal's handler runs on this thread: none is under way here */
}

static int open_terminal(void)
{
    struct termios raw;
    const int terminal = posix_openpt(O_RDWR | O_NOCTTY);
    if (terminal < 0 || grantpt(terminal) != 0 || unlockpt(terminal) != 0)
        return -1;
    const char *name = ptsname(terminal);
    /* kept open, so that the terminal outlives the host's closing; and raw, as a line of bytes is */
    const int other_side = name == NULL ? -1 : open(name, O_RDWR | O_NOCTTY);
    if (other_side < 0 || tcgetattr(other_side, &raw) != 0)
        return -1;
    raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
    raw.c_cflag |= CS8;
    if (tcsetattr(other_side, TCSANOW, &raw) != 0 || fcntl(terminal, F_SETFL, O_NONBLOCK) != 0)
        return -1;
    (void)printf("%s\n", name);
    return fflush(stdout) == 0 ? terminal : -1;
}

/* Move bytes both ways until standard input ends. */
static void serve(int terminal)
{
    static uint8_t in[256], out[4096];
    size_t in_length = 0, in_taken = 0, out_length = 0, out_sent = 0;
    for (;;) {
        if (out_sent == out_length) {
            out_sent = 0;
            out_length = probe_transmit(&board, out, sizeof out);
            while (out_length == 0 && is_fast && is_converting) {
                convert();
                out_length = probe_transmit(&board, out, sizeof out);
            }
        }
        in_taken += probe_receive(&board, in + in_taken, in_length - in_taken);
        struct pollfd files[2] = {{terminal, 0, 0}, {STDIN_FILENO, POLLIN, 0}};
        if (in_taken == in_length)
            files[0].events |= POLLIN;
        if (out_sent < out_length)
            files[0].events |= POLLOUT;
        if (poll(files, 2, 1) > 0) { /* ms: frames that the signal has queued wait no longer */
            uint8_t ignored[64];
            if (files[1].revents != 0 && read(STDIN_FILENO, ignored, sizeof ignored) <= 0)
                return;
            if ((files[0].revents & POLLOUT) != 0) {
                const ssize_t count = write(terminal, out + out_sent, out_length - out_sent);
                out_sent += count > 0 ? (size_t)count : 0;
            }
            if ((files[0].revents & POLLIN) != 0) {
                const ssize_t count = read(terminal, in, sizeof in);
                in_length = count > 0 ? (size_t)count : 0;
                in_taken = 0;
            }
        }
    }
}

/* Return the option's number, or 0, which probe_init refuses. */
static uint32_t read_number(uint32_t highest)
{
    const unsigned long number = strtoul(optarg, NULL, 10);
    return number > highest ? 0 : (uint32_t)number;
}

int main(int argc, char **argv)
{
    probe_config config = {.channels = 2, .frame_size = 64, .is_serial = true, .lowest_rate_mhz = 1000,
                           .highest_rate_mhz = HIGHEST_RATE_MHZ, .rate_mhz = 1000000, .scale = {6e-9f, 6e-9f, 5e-8f},
                           .firmware = "posix board 1", .start = start, .stop = stop};
    for (int option; (option = getopt(argc, argv, "s:c:r:f")) != -1;) {
        switch (option) {
        case 's': config.frame_size = (uint16_t)read_number(PROBE_MAX_FRAME); break;
        case 'c': config.channels = (uint8_t)read_number(PROBE_MAX_CHANNELS); break;
        case 'r': config.rate_mhz = 1000u * read_number(HIGHEST_RATE_MHZ / 1000u); break;
        case 'f': is_fast = true; break;
        default: return 2;
        }
    }
    if (!probe_init(&board, &config, memory, sizeof memory)) {
        (void)fprintf(stderr, "allowed: -s 32 to 1024, -c 2 or 3, -r 1 to 100000\n");
        return 2;
    }
    struct sigaction action = {.sa_handler = on_tick, .sa_flags = SA_RESTART};
    const struct itimerval interval = {{0, TICK_US}, {0, TICK_US}};
    const int terminal = open_terminal();
    if (terminal < 0 || sigaction(SIGALRM, &action, NULL) != 0 || setitimer(ITIMER_REAL, &interval, NULL) != 0) {
        perror("posix_board");
        return 1;
    }
    serve(terminal);
    return 0;
}
