/* The device side of docs/reference/protocol.md, version 1, in C99: no library, no malloc, no operating system.
 *
 * Two contexts call it. The conversion interrupt calls probe_convert alone. Everything else is called from the main loop, or
 * from interrupts that exclude one another (those of a USB stack). Between the two there is a ring of frames: the interrupt
 * moves its head, the main loop its tail, so that no lock is needed. Loads and stores of 16 and 32 bits must be atomic, as they
 * are on every Cortex-M and RISC-V core of 32 bits; PROBE_BARRIER orders them.
 *
 * Floating point occurs once: the volts per count that GET_INFO reports, binary32 of IEEE 754. They are copied, not computed.
 */
#ifndef PROBE_BOARD_H
#define PROBE_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifndef PROBE_BARRIER
#define PROBE_BARRIER() __sync_synchronize() /* gcc and clang; other compilers: their full memory barrier */
#endif

enum {
    PROBE_VERSION = 1,
    PROBE_MAX_CHANNELS = 3, /* inner film, outer film, force */
    PROBE_MIN_FRAME = 32,
    PROBE_MAX_FRAME = 1024,
    PROBE_INFO_BYTES = 44,
    PROBE_STATUS_BYTES = 16,
    PROBE_REQUEST_BYTES = 14,                      /* of a request on a serial port */
    PROBE_RESPONSE_BYTES = 6 + PROBE_INFO_BYTES + 4 /* of the longest response there */
};

enum { PROBE_GET_INFO = 1, PROBE_SET_RATE = 2, PROBE_START = 3, PROBE_STOP = 4, PROBE_GET_STATUS = 5 };

/* Rows of a frame, and the memory that 100 ms at the highest rate (mHz) need: those frames, rounded up, the frame that is on
 * its way to the host, and a slot that tells a full ring from an empty one. Constant expressions, for static arrays. */
#define PROBE_ROWS_THAT_FIT(channels, frame_size) (((frame_size)-24) / (2 * (channels)))
#define PROBE_ROWS(channels, frame_size) \
    (PROBE_ROWS_THAT_FIT(channels, frame_size) < 255 ? PROBE_ROWS_THAT_FIT(channels, frame_size) : 255)
#define PROBE_BUFFER_BYTES(channels, frame_size, highest_rate_mhz) \
    ((size_t)(frame_size) * ((size_t)((highest_rate_mhz) / 10000u) / (size_t)PROBE_ROWS(channels, frame_size) + 3u))

/* What a board binds: its numbers and the functions that reach its hardware. */
typedef struct {
    uint8_t channels;          /* 2 (inner, outer) or 3 (inner, outer, force) */
    uint16_t frame_size;       /* bytes: wMaxPacketSize on USB; 32 to 1024 on a serial port */
    bool is_serial;            /* a serial port, where GET_INFO states the size of frames; on USB it states 0 */
    uint32_t lowest_rate_mhz;  /* samples per second and channel, in mHz; at least 1 */
    uint32_t highest_rate_mhz;
    uint32_t rate_mhz;         /* after power-up */
    float scale[PROBE_MAX_CHANNELS]; /* V per count, at the output of the charge amplifier */
    const char *firmware;      /* name and version, ASCII; the first 16 characters are sent */
    void *context;             /* handed to the functions */
    /* Set the timer to the nearest rate it can do, and return that rate; conversions are stopped. NULL: any rate is exact. */
    uint32_t (*set_rate)(void *context, uint32_t rate_mhz);
    /* Begin to convert. */
    void (*start)(void *context);
    /* End conversions. On return no probe_convert runs, and none comes before start. */
    void (*stop)(void *context);
    /* End a halt of the endpoint and take back the frame that waits there; return true if that frame is not read any more.
     * NULL, or false: the frame leaves whole, and the host drops it by its stream number. */
    bool (*flush)(void *context);
} probe_config;

typedef struct {
    probe_config config;
    uint8_t *memory;
    uint16_t slots;      /* frames that fit into the memory */
    uint8_t rows_limit;  /* rows after which a frame is queued: full, or 50 ms after its first sample */
    uint16_t stream;     /* 0: stopped */
    /* written by the conversions alone while they run */
    volatile uint16_t head; /* slot that is being filled */
    volatile uint64_t index;
    volatile uint32_t sequence;
    volatile uint16_t overruns;
    uint8_t rows;
    bool is_dropping;
    /* written by the main loop alone */
    volatile uint16_t tail; /* slot that is sent next */
    bool is_sending;        /* the transport reads the slot at the tail */
    /* of a serial port */
    uint16_t bytes_sent; /* of the frame at the tail */
    uint8_t request[PROBE_REQUEST_BYTES];
    uint8_t request_length;
    uint8_t response[PROBE_RESPONSE_BYTES];
    uint8_t response_length, response_sent;
} probe_board;

/* Prepare a stopped board; the memory stays in use. Returns false if the protocol has no such frames, a rate is out of order,
 * a function is missing, or the memory holds less than 100 ms (PROBE_BUFFER_BYTES). */
bool probe_init(probe_board *board, const probe_config *config, uint8_t *memory, size_t memory_size);

/* Add one conversion of all channels; from the conversion interrupt. Bit c of `saturated`: the analog part of channel c was
 * saturated. */
void probe_convert(probe_board *board, const int16_t *codes, uint8_t saturated);

/* Return the code of a converter's value in two's complement of 8 to 32 bits: its ends, and nothing else, become -32768 and
 * 32767; others are scaled to 16 bits, rounded half up. */
int16_t probe_scale_code(int32_t value, unsigned bits);

/* Execute a request. `data` are the bytes that came with it. Returns false if it is refused: stall endpoint 0. The response has
 * at most PROBE_INFO_BYTES. */
bool probe_request(probe_board *board, uint8_t number, uint16_t value, const uint8_t *data, size_t length, uint8_t *response,
                   size_t *response_length);

/* After a bus reset or SET_CONFIGURATION: stop, and drop all frames, that on its way included. */
void probe_reset(probe_board *board);

/* USB: return the next frame, of frame_size bytes, or NULL. It stays in place until probe_release_frame. */
const uint8_t *probe_next_frame(probe_board *board);
void probe_release_frame(probe_board *board);

/* Serial port: take received bytes, execute the requests among them, and return how many were taken. The others wait, because
 * the response to a request has not been sent yet. */
size_t probe_receive(probe_board *board, const uint8_t *data, size_t length);

/* Serial port: write the next bytes to send, and return how many. A response stands between two frames. */
size_t probe_transmit(probe_board *board, uint8_t *data, size_t capacity);

/* Return the CRC-32 of Ethernet and zlib. */
uint32_t probe_crc32(const uint8_t *data, size_t length);

#endif
