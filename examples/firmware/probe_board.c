#include "probe_board.h"

#include <string.h>

typedef char float_has_32_bits[sizeof(float) == 4 ? 1 : -1];

enum { HEAD_BYTES = 20, CRC_BYTES = 4, ROWS_OFFSET = 18, FLAGS_OFFSET = 19, OVERRUN_FLAG = 1, SATURATED_SHIFT = 4 };
enum { REFUSED_BIT = 0x80, RESPONSE_HEAD_BYTES = 6 };
#define FRAMES_PER_SECOND_MHZ 20000u /* a frame waits 50 ms at most */

static void put_u16(uint8_t *to, uint16_t value)
{
    to[0] = (uint8_t)(value & 0xFFu);
    to[1] = (uint8_t)(value >> 8);
}

static void put_u32(uint8_t *to, uint32_t value)
{
    put_u16(to, (uint16_t)(value & 0xFFFFu));
    put_u16(to + 2, (uint16_t)(value >> 16));
}

static void put_u64(uint8_t *to, uint64_t value)
{
    put_u32(to, (uint32_t)(value & 0xFFFFFFFFu));
    put_u32(to + 4, (uint32_t)(value >> 32));
}

static void put_float(uint8_t *to, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_u32(to, bits);
}

static uint32_t get_u32(const uint8_t *from)
{
    return (uint32_t)from[0] | (uint32_t)from[1] << 8 | (uint32_t)from[2] << 16 | (uint32_t)from[3] << 24;
}

uint32_t probe_crc32(const uint8_t *data, size_t length)
{
    /* four bits at a time: 64 bytes of table in place of 1024 */
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
        0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
    };
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t k = 0; k < length; k++) {
        crc ^= data[k];
        crc = crc >> 4 ^ table[crc & 15u];
        crc = crc >> 4 ^ table[crc & 15u];
    }
    return ~crc;
}

int16_t probe_scale_code(int32_t value, unsigned bits)
{
    const int64_t top = ((int64_t)1 << (bits - 1)) - 1;
    if (value >= top)
        return INT16_MAX;
    if (value <= -top - 1)
        return INT16_MIN;
    if (bits <= 16)
        return (int16_t)(value * (1 << (16 - bits)));
    const int64_t unit = (int64_t)1 << (bits - 16);
    const int64_t shifted = (int64_t)value + top + 1 + unit / 2; /* not negative, so that the division rounds down */
    const int64_t code = shifted / unit + INT16_MIN;
    return (int16_t)(code >= INT16_MAX ? INT16_MAX - 1 : code <= INT16_MIN ? INT16_MIN + 1 : code);
}

/* ---- the ring of frames ---- */

static uint16_t next_slot(const probe_board *board, uint16_t slot)
{
    return (uint16_t)(slot + 1u == board->slots ? 0u : slot + 1u);
}

static uint8_t *slot_at(const probe_board *board, uint16_t slot)
{
    return board->memory + (size_t)slot * board->config.frame_size;
}

static void begin_frame(probe_board *board, uint8_t *frame)
{
    memset(frame, 0, board->config.frame_size);
    frame[0] = 'P';
    frame[1] = 'D';
    frame[2] = PROBE_VERSION;
    frame[3] = board->config.channels;
    put_u32(frame + 4, board->sequence);
    put_u64(frame + 8, board->index);
    put_u16(frame + 16, board->stream);
    frame[FLAGS_OFFSET] = board->is_dropping ? OVERRUN_FLAG : 0;
    board->is_dropping = false;
}

void probe_convert(probe_board *board, const int16_t *codes, uint8_t saturated)
{
    const uint16_t head = board->head;
    uint8_t *frame = slot_at(board, head);
    if (board->rows == 0) {
        if (next_slot(board, head) == board->tail) { /* full: new samples are dropped, queued ones stay */
            if (!board->is_dropping)
                board->overruns = (uint16_t)(board->overruns + 1u);
            board->is_dropping = true;
            board->index = board->index + 1u;
            return;
        }
        PROBE_BARRIER(); /* the main loop has read this slot before it moved the tail */
        begin_frame(board, frame);
    }
    uint8_t *row = frame + HEAD_BYTES + 2u * board->config.channels * board->rows;
    for (uint8_t c = 0; c < board->config.channels; c++)
        put_u16(row + 2 * c, (uint16_t)codes[c]);
    frame[FLAGS_OFFSET] = (uint8_t)(frame[FLAGS_OFFSET] | (saturated & ((1u << board->config.channels) - 1u)) << SATURATED_SHIFT);
    board->rows = (uint8_t)(board->rows + 1u);
    if (board->rows == board->rows_limit) {
        frame[ROWS_OFFSET] = board->rows;
        board->rows = 0;
        board->sequence = board->sequence + 1u;
        PROBE_BARRIER(); /* the frame is whole before the main loop sees it */
        board->head = next_slot(board, head);
    }
    board->index = board->index + 1u;
}

const uint8_t *probe_next_frame(probe_board *board)
{
    if (board->tail == board->head)
        return NULL;
    PROBE_BARRIER(); /* the frame is read after the head */
    uint8_t *frame = slot_at(board, board->tail);
    if (!board->is_sending) { /* here and not in the interrupt, which has to be short */
        const size_t body = (size_t)board->config.frame_size - CRC_BYTES;
        put_u32(frame + body, probe_crc32(frame, body));
        board->is_sending = true;
    }
    return frame;
}

void probe_release_frame(probe_board *board)
{
    if (!board->is_sending)
        return;
    board->is_sending = false;
    PROBE_BARRIER(); /* the frame was read before the interrupt may fill its slot */
    board->tail = next_slot(board, board->tail);
}

/* ---- streams ---- */

/* End the stream and drop what is queued. A frame on its way stays, unless the transport has taken it back. */
static void end_stream(probe_board *board, bool was_taken_back)
{
    board->config.stop(board->config.context);
    board->stream = 0;
    if (board->config.flush != NULL && board->config.flush(board->config.context))
        was_taken_back = true;
    if (was_taken_back) {
        board->is_sending = false;
        board->bytes_sent = 0;
    }
    board->head = board->is_sending ? next_slot(board, board->tail) : board->tail;
    board->rows = 0;
}

static void begin_stream(probe_board *board, uint16_t stream)
{
    const uint32_t rows = PROBE_ROWS((uint32_t)board->config.channels, (uint32_t)board->config.frame_size);
    const uint32_t timely = 1u + board->config.rate_mhz / FRAMES_PER_SECOND_MHZ; /* the last of them comes after 50 ms at most */
    board->rows_limit = (uint8_t)(timely < rows ? timely : rows);
    board->index = 0;
    board->sequence = 0;
    board->overruns = 0;
    board->is_dropping = false;
    board->stream = stream;
    board->config.start(board->config.context);
}

static void set_rate(probe_board *board, uint32_t rate_mhz)
{
    probe_config *config = &board->config;
    uint32_t allowed = rate_mhz < config->lowest_rate_mhz ? config->lowest_rate_mhz : rate_mhz;
    allowed = allowed > config->highest_rate_mhz ? config->highest_rate_mhz : allowed;
    config->rate_mhz = config->set_rate == NULL ? allowed : config->set_rate(config->context, allowed);
}

bool probe_init(probe_board *board, const probe_config *config, uint8_t *memory, size_t memory_size)
{
    if (config->channels < 2 || config->channels > PROBE_MAX_CHANNELS || config->frame_size < PROBE_MIN_FRAME ||
        config->frame_size > PROBE_MAX_FRAME || config->lowest_rate_mhz == 0 || config->rate_mhz < config->lowest_rate_mhz ||
        config->highest_rate_mhz < config->rate_mhz || config->start == NULL || config->stop == NULL || config->firmware == NULL)
        return false;
    const size_t needed = PROBE_BUFFER_BYTES(config->channels, config->frame_size, config->highest_rate_mhz);
    const size_t slots = memory_size / config->frame_size;
    if (memory_size < needed || needed / config->frame_size > UINT16_MAX)
        return false;
    memset(board, 0, sizeof *board);
    board->config = *config;
    board->memory = memory;
    board->slots = (uint16_t)(slots < UINT16_MAX ? slots : UINT16_MAX);
    set_rate(board, config->rate_mhz);
    return true;
}

void probe_reset(probe_board *board)
{
    end_stream(board, true);
    board->request_length = board->response_length = board->response_sent = 0;
}

/* ---- requests ---- */

static size_t write_info(const probe_board *board, uint8_t *to)
{
    const probe_config *config = &board->config;
    memset(to, 0, PROBE_INFO_BYTES);
    to[0] = PROBE_VERSION;
    to[1] = config->channels;
    put_u16(to + 2, config->is_serial ? config->frame_size : 0);
    put_u32(to + 4, config->rate_mhz);
    put_u32(to + 8, config->highest_rate_mhz);
    for (uint8_t c = 0; c < config->channels; c++)
        put_float(to + 12 + 4 * c, config->scale[c]);
    for (size_t k = 0; k < 16 && config->firmware[k] != '\0'; k++)
        to[28 + k] = (uint8_t)config->firmware[k];
    return PROBE_INFO_BYTES;
}

static size_t write_status(const probe_board *board, uint8_t *to)
{
    uint64_t index;
    put_u16(to, board->stream);
    do { /* every conversion changes the index, which has 64 bits: if both readings agree, none came in between */
        index = board->index;
        PROBE_BARRIER();
        put_u16(to + 2, board->overruns);
        put_u32(to + 4, board->sequence);
        PROBE_BARRIER();
    } while (index != board->index);
    put_u64(to + 8, index);
    return PROBE_STATUS_BYTES;
}

bool probe_request(probe_board *board, uint8_t number, uint16_t value, const uint8_t *data, size_t length, uint8_t *response,
                   size_t *response_length)
{
    *response_length = 0;
    switch (number) {
    case PROBE_GET_INFO:
        *response_length = write_info(board, response);
        return true;
    case PROBE_SET_RATE:
        if (board->stream != 0 || length != 4)
            return false;
        set_rate(board, get_u32(data));
        return true;
    case PROBE_START:
        if (value == 0)
            return false;
        end_stream(board, false);
        begin_stream(board, value);
        return true;
    case PROBE_STOP:
        end_stream(board, false);
        return true;
    case PROBE_GET_STATUS:
        *response_length = write_status(board, response);
        return true;
    default:
        return false;
    }
}

/* ---- the serial port ---- */

static void respond(probe_board *board)
{
    const uint8_t *request = board->request;
    size_t length = 0;
    uint8_t *response = board->response;
    const uint16_t value = (uint16_t)(request[4] | request[5] << 8);
    const bool is_granted = request[2] == PROBE_VERSION && probe_request(board, request[3], value, request + 6, 4,
                                                                         response + RESPONSE_HEAD_BYTES, &length);
    response[0] = 'P';
    response[1] = 'A';
    response[2] = PROBE_VERSION;
    response[3] = (uint8_t)(is_granted ? request[3] : request[3] | REFUSED_BIT);
    put_u16(response + 4, (uint16_t)length);
    put_u32(response + RESPONSE_HEAD_BYTES + length, probe_crc32(response, RESPONSE_HEAD_BYTES + length));
    board->response_length = (uint8_t)(RESPONSE_HEAD_BYTES + length + CRC_BYTES);
    board->response_sent = 0;
}

/* Drop bytes from the front of the request until the others may begin one. */
static void align_request(probe_board *board)
{
    uint8_t *request = board->request;
    size_t skipped = 0, length = board->request_length;
    while (skipped < length && (request[skipped] != 'P' || (skipped + 1 < length && request[skipped + 1] != 'Q')))
        skipped++;
    memmove(request, request + skipped, length - skipped);
    board->request_length = (uint8_t)(length - skipped);
}

size_t probe_receive(probe_board *board, const uint8_t *data, size_t length)
{
    size_t taken = 0;
    while (taken < length && board->response_length == 0) {
        board->request[board->request_length++] = data[taken++];
        align_request(board);
        if (board->request_length < PROBE_REQUEST_BYTES)
            continue;
        if (get_u32(board->request + PROBE_REQUEST_BYTES - CRC_BYTES) ==
            probe_crc32(board->request, PROBE_REQUEST_BYTES - CRC_BYTES)) {
            board->request_length = 0;
            respond(board);
        } else { /* damaged, or no request: a true one may begin within it */
            board->request[0] = 0;
            align_request(board);
        }
    }
    return taken;
}

static size_t copy_some(uint8_t *to, size_t capacity, const uint8_t *from, size_t length)
{
    const size_t count = length < capacity ? length : capacity;
    memcpy(to, from, count);
    return count;
}

size_t probe_transmit(probe_board *board, uint8_t *data, size_t capacity)
{
    size_t count = 0;
    while (count < capacity) {
        if (board->response_length != 0 && board->bytes_sent == 0) {
            const size_t left = (size_t)board->response_length - board->response_sent;
            const size_t copied = copy_some(data + count, capacity - count, board->response + board->response_sent, left);
            board->response_sent = (uint8_t)(board->response_sent + copied);
            if (copied == left)
                board->response_length = 0;
            count += copied;
            continue;
        }
        const uint8_t *frame = probe_next_frame(board);
        if (frame == NULL)
            break;
        const size_t left = (size_t)board->config.frame_size - board->bytes_sent;
        const size_t copied = copy_some(data + count, capacity - count, frame + board->bytes_sent, left);
        board->bytes_sent = (uint16_t)(board->bytes_sent + copied);
        count += copied;
        if (copied == left) {
            board->bytes_sent = 0;
            probe_release_frame(board);
        }
    }
    return count;
}
