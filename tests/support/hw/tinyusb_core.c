/* The part of TinyUSB between a host and examples/firmware/tinyusb_board.c, with a host that standard input drives:
 *
 *     'C' bmRequestType, bRequest, wValue, wIndex, wLength, [data]   a control transfer -> 1, length, data; or 0: stalled
 *     'U'                                                            a read of one packet -> length, data; 0: nothing to send
 *     'H'                                                            SET_FEATURE(ENDPOINT_HALT): a waiting transfer is lost
 *     'N'                                                            CLEAR_FEATURE(ENDPOINT_HALT)
 *     'B'                                                            bus reset and SET_CONFIGURATION
 *
 * Channel c converts the code 7919 index + 31 c modulo 65533 - 32766. */
#include <stdio.h>
#include <stdlib.h>

#include "device/usbd_pvt.h"
#include "tinyusb_board.h"

static probe_board board;
static uint8_t memory[PROBE_BUFFER_BYTES(2, PROBE_USB_PACKET, 1000000u)];
static bool is_converting, is_stalled;
static uint64_t converted;
static const uint8_t *waiting; /* the packet of the endpoint */
static uint16_t waiting_length;
static void *control_data;
static uint16_t control_length;
static bool has_status;

bool tud_control_xfer(uint8_t rhport, const tusb_control_request_t *request, void *buffer, uint16_t len)
{
    (void)rhport;
    control_data = buffer;
    control_length = len < request->wLength ? len : request->wLength;
    return true;
}

bool tud_control_status(uint8_t rhport, const tusb_control_request_t *request)
{
    (void)rhport, (void)request;
    return has_status = true;
}

bool usbd_edpt_open(uint8_t rhport, const tusb_desc_endpoint_t *endpoint)
{
    (void)rhport;
    return endpoint->bLength == 7 && endpoint->bDescriptorType == 5 && endpoint->bEndpointAddress == 0x81;
}

bool usbd_edpt_xfer(uint8_t rhport, uint8_t address, uint8_t *buffer, uint16_t total_bytes)
{
    (void)rhport, (void)address;
    if (waiting != NULL)
        exit(4);
    waiting = buffer;
    waiting_length = total_bytes;
    return true;
}

bool usbd_edpt_busy(uint8_t rhport, uint8_t address) { (void)rhport, (void)address; return waiting != NULL; }
bool usbd_edpt_stalled(uint8_t rhport, uint8_t address) { (void)rhport, (void)address; return is_stalled; }
void usbd_edpt_clear_stall(uint8_t rhport, uint8_t address) { (void)rhport, (void)address; is_stalled = false; }

static void start(void *context) { (void)context; is_converting = true; converted = 0; }
static void stop(void *context) { (void)context; is_converting = false; }

static void convert(void)
{
    int16_t codes[2];
    for (unsigned c = 0; c < 2; c++)
        codes[c] = (int16_t)((int32_t)((7919u * converted + 31u * c) % 65533u) - 32766);
    converted++;
    probe_convert(&board, codes, 0);
}

static unsigned take(unsigned bytes)
{
    unsigned value = 0;
    for (unsigned k = 0; k < bytes; k++)
        value |= (unsigned)getchar() << 8 * k;
    return value;
}

static void give_data(const uint8_t *data, uint16_t length)
{
    (void)putchar(length & 0xFF), (void)putchar(length >> 8);
    for (uint16_t k = 0; k < length; k++)
        (void)putchar(data[k]);
}

static const uint8_t *find_descriptor(unsigned type, unsigned index)
{
    const uint8_t *found = type == 1 ? tud_descriptor_device_cb() : type == 2 ? tud_descriptor_configuration_cb(0) : NULL;
    found = type == 3 ? (const uint8_t *)tud_descriptor_string_cb((uint8_t)index, 0x0409) : found;
    return type == 15 ? tud_descriptor_bos_cb() : found;
}

static void control(void)
{
    static uint8_t received[4096];
    tusb_control_request_t request;
    request.bmRequestType = (uint8_t)take(1);
    request.bRequest = (uint8_t)take(1);
    request.wValue = (uint16_t)take(2);
    request.wIndex = (uint16_t)take(2);
    request.wLength = (uint16_t)take(2);
    const bool is_in = (request.bmRequestType & 0x80) != 0;
    for (unsigned k = 0; !is_in && k < request.wLength; k++)
        received[k % sizeof received] = (uint8_t)take(1);
    control_data = NULL;
    control_length = 0;
    has_status = false;
    bool is_granted = false;
    if (request.bmRequestType == 0x80 && request.bRequest == 6) {
        const uint8_t *found = find_descriptor(request.wValue >> 8, request.wValue & 0xFF);
        if ((is_granted = found != NULL) == true) {
            const unsigned type = request.wValue >> 8;
            const unsigned total = type == 2 || type == 15 ? (unsigned)(found[2] | found[3] << 8) : found[0];
            (void)tud_control_xfer(0, &request, (void *)(uintptr_t)found, (uint16_t)total);
        }
    } else {
        is_granted = tud_vendor_control_xfer_cb(0, CONTROL_STAGE_SETUP, &request);
        if (is_granted && !is_in && control_data != NULL) {
            for (unsigned k = 0; k < control_length; k++)
                ((uint8_t *)control_data)[k] = received[k];
            is_granted = tud_vendor_control_xfer_cb(0, CONTROL_STAGE_DATA, &request);
        } else if (is_granted && control_data == NULL && !has_status)
            exit(6);
    }
    (void)putchar(is_granted);
    if (is_granted)
        give_data(control_data, is_in ? control_length : 0);
}

static void read_packet(void)
{
    const usbd_class_driver_t *driver = usbd_app_driver_get_cb(&(uint8_t){0});
    probe_usb_task();
    for (unsigned k = 0; waiting == NULL && is_converting && !is_stalled && k < 300; k++) {
        convert();
        probe_usb_task();
    }
    if (waiting == NULL || is_stalled) {
        give_data(NULL, 0);
        return;
    }
    give_data(waiting, waiting_length);
    waiting = NULL;
    if (!driver->xfer_cb(0, 0x81, XFER_RESULT_SUCCESS, waiting_length))
        exit(7);
}

static void configure(void)
{
    uint8_t count = 0;
    const usbd_class_driver_t *driver = usbd_app_driver_get_cb(&count);
    waiting = NULL;
    is_stalled = false;
    driver->reset(0);
    if (driver->open(0, (const tusb_desc_interface_t *)(const void *)(tud_descriptor_configuration_cb(0) + 9), 16) != 16)
        exit(8);
}

int main(void)
{
    const probe_config config = {.channels = 2, .frame_size = PROBE_USB_PACKET, .lowest_rate_mhz = 1000,
                                 .highest_rate_mhz = 1000000u, .rate_mhz = 1000000u, .scale = {1e-4f, 1e-4f},
                                 .firmware = "tinyusb board 1", .start = start, .stop = stop, .flush = probe_usb_flush};
    if (!probe_init(&board, &config, memory, sizeof memory))
        return 2;
    probe_usb_init(&board, "A17");
    configure();
    for (int step; (step = getchar()) != EOF;) {
        switch (step) {
        case 'C': control(); break;
        case 'U': read_packet(); break;
        case 'H': is_stalled = true; waiting = NULL; break;
        case 'N': is_stalled = false; break;
        case 'B': configure(); break;
        default: return 5;
        }
        (void)fflush(stdout);
    }
    return 0;
}
