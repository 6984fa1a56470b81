/* Calls the functions of examples/firmware as a script from standard input says, and prints what they return.
 *
 * Each step is a letter and its arguments, little-endian; `execute` lists them. Every buffer has its exact size, so that
 * -fsanitize=address sees each byte too many. Standard output holds the results, in the order of the steps. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drive.h"
#include "probe_board.h"

static probe_board board;
static uint8_t *memory;
static bool is_converting, takes_back;

static void start(void *context) { (void)context; is_converting = true; }
static void stop(void *context) { (void)context; is_converting = false; }
static bool flush(void *context) { (void)context; return takes_back; }

static uint32_t take(size_t bytes)
{
    uint32_t value = 0;
    for (size_t k = 0; k < bytes; k++) {
        const int byte = getchar();
        if (byte == EOF)
            exit(3);
        value |= (uint32_t)byte << 8 * k;
    }
    return value;
}

static void give(uint32_t value, size_t bytes)
{
    for (size_t k = 0; k < bytes; k++)
        (void)putchar((int)(value >> 8 * k & 0xFFu));
}

static uint8_t *allocate(size_t length)
{
    uint8_t *data = malloc(length);
    if (data == NULL && length != 0)
        exit(4);
    return data;
}

static uint8_t *take_data(size_t length)
{
    uint8_t *data = allocate(length);
    for (size_t k = 0; k < length; k++)
        data[k] = (uint8_t)take(1);
    return data;
}

static void give_data(const uint8_t *data, size_t length)
{
    give((uint32_t)length, 2);
    for (size_t k = 0; k < length; k++)
        give(data[k], 1);
}

static void initialise(void)
{
    probe_config config = {.scale = {0.25f, 0.5f, 1e-4f}, .firmware = "script of sixteen and more", .start = start, .stop = stop, .flush = flush};
    config.channels = (uint8_t)take(1);
    config.frame_size = (uint16_t)take(2);
    config.is_serial = take(1) != 0;
    config.lowest_rate_mhz = take(4);
    config.highest_rate_mhz = take(4);
    config.rate_mhz = take(4);
    const size_t size = take(4);
    free(memory);
    memory = allocate(size);
    is_converting = takes_back = false;
    give(probe_init(&board, &config, memory, size), 1);
}

static void convert(void)
{
    const uint32_t count = take(4);
    const uint8_t saturated = (uint8_t)take(1);
    for (uint32_t k = 0; k < count; k++) {
        int16_t codes[PROBE_MAX_CHANNELS];
        for (uint8_t c = 0; c < board.config.channels; c++)
            codes[c] = (int16_t)take(2);
        if (is_converting)
            probe_convert(&board, codes, saturated);
    }
}

static void request(void)
{
    const uint8_t number = (uint8_t)take(1);
    const uint16_t value = (uint16_t)take(2);
    size_t length = take(2);
    uint8_t *data = take_data(length), *response = allocate(PROBE_INFO_BYTES);
    give(probe_request(&board, number, value, data, length, response, &length), 1);
    give_data(response, length);
    free(data);
    free(response);
}

static void execute(int step)
{
    size_t length;
    uint8_t *data;
    const uint8_t *frame;
    probe_drive drive = {0, 0, 0};
    switch (step) {
    case 'I': initialise(); break;
    case 'V': convert(); break;
    case 'C': request(); break;
    case 'B': probe_reset(&board); break;
    case 'F': takes_back = take(1) != 0; break;
    case 'P': /* the next frame, which stays on its way */
        frame = probe_next_frame(&board);
        give_data(frame, frame == NULL ? 0 : board.config.frame_size);
        break;
    case 'L': probe_release_frame(&board); break;
    case 'R':
        length = take(2);
        data = take_data(length);
        give((uint32_t)probe_receive(&board, data, length), 2);
        free(data);
        break;
    case 'T':
        length = take(2);
        data = allocate(length);
        give_data(data, probe_transmit(&board, data, length));
        free(data);
        break;
    case 'D': {
        const uint32_t frequency = take(4), rate = take(4);
        give(probe_drive_set(&drive, frequency, rate, (uint16_t)take(2)), 1);
        for (uint32_t count = take(4); count > 0; count--)
            give((uint32_t)probe_drive_next(&drive), 2);
        break;
    }
    case 'S': {
        const unsigned bits = take(1);
        for (uint32_t count = take(4); count > 0; count--)
            give((uint32_t)probe_scale_code((int32_t)take(4), bits), 2);
        break;
    }
    case 'K':
        length = take(2);
        data = take_data(length);
        give(probe_crc32(data, length), 4);
        free(data);
        break;
    default: exit(5);
    }
}

int main(void)
{
    for (int step; (step = getchar()) != EOF;)
        execute(step);
    free(memory);
    return 0;
}
