#include "tinyusb_board.h"

#include "device/usbd_pvt.h"
#include "tusb.h"

#ifndef PROBE_USB_TRANSFER /* newer versions of TinyUSB have a fifth argument, is_isr: false */
#define PROBE_USB_TRANSFER(port, endpoint, data, length) usbd_edpt_xfer(port, endpoint, data, length)
#endif

enum { ENDPOINT = 0x81, VENDOR_IN = 0xC0, VENDOR_OUT = 0x40, MS_OS_20 = 0x20, MS_OS_20_INDEX = 7, INTERFACE_BYTES = 9 + 7 };

static const uint8_t device_descriptor[18] = {
    18, 1, 0x10, 0x02, 0, 0, 0, 64, 0x09, 0x12, 0x01, 0x00, 0x00, 0x01, 1, 2, 3, 1, /* 1209:0001; strings 1 to 3 */
};
static const uint8_t configuration_descriptor[25] = {
    9, 2, 25, 0, 1, 1, 0, 0x80, 50,                                   /* one interface, 100 mA */
    9, 4, 0, 0, 1, 0xFF, 0, 0, 0,                                     /* vendor class, one endpoint */
    7, 5, ENDPOINT, 2, PROBE_USB_PACKET & 0xFF, PROBE_USB_PACKET >> 8, 0, /* bulk IN */
};
/* printed by docs/make_protocol.py */
static const uint8_t bos_descriptor[33] = {
    0x05, 0x0f, 0x21, 0x00, 0x01, 0x1c, 0x10, 0x05, 0x00, 0xdf, 0x60, 0xdd, 0xd8, 0x89, 0x45, 0xc7, 0x4c, 0x9c, 0xd2, 0x65,
    0x9d, 0x9e, 0x64, 0x8a, 0x9f, 0x00, 0x00, 0x03, 0x06, 0xa2, 0x00, 0x20, 0x00,
};
static const uint8_t microsoft_descriptor_set[162] = {
    0x0a, 0x00, 0x00, 0x00, 0x00, 0x00, 0x03, 0x06, 0xa2, 0x00, 0x14, 0x00, 0x03, 0x00, 0x57, 0x49, 0x4e, 0x55, 0x53, 0x42,
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x84, 0x00, 0x04, 0x00, 0x07, 0x00, 0x2a, 0x00, 0x44, 0x00,
    0x65, 0x00, 0x76, 0x00, 0x69, 0x00, 0x63, 0x00, 0x65, 0x00, 0x49, 0x00, 0x6e, 0x00, 0x74, 0x00, 0x65, 0x00, 0x72, 0x00,
    0x66, 0x00, 0x61, 0x00, 0x63, 0x00, 0x65, 0x00, 0x47, 0x00, 0x55, 0x00, 0x49, 0x00, 0x44, 0x00, 0x73, 0x00, 0x00, 0x00,
    0x50, 0x00, 0x7b, 0x00, 0x36, 0x00, 0x63, 0x00, 0x32, 0x00, 0x64, 0x00, 0x39, 0x00, 0x61, 0x00, 0x34, 0x00, 0x31, 0x00,
    0x2d, 0x00, 0x33, 0x00, 0x66, 0x00, 0x30, 0x00, 0x62, 0x00, 0x2d, 0x00, 0x34, 0x00, 0x65, 0x00, 0x35, 0x00, 0x38, 0x00,
    0x2d, 0x00, 0x39, 0x00, 0x62, 0x00, 0x31, 0x00, 0x63, 0x00, 0x2d, 0x00, 0x37, 0x00, 0x61, 0x00, 0x35, 0x00, 0x64, 0x00,
    0x65, 0x00, 0x32, 0x00, 0x30, 0x00, 0x63, 0x00, 0x38, 0x00, 0x66, 0x00, 0x33, 0x00, 0x36, 0x00, 0x7d, 0x00, 0x00, 0x00,
    0x00, 0x00,
};

static probe_board *board;
static const char *strings[4] = {NULL, "probe-design", "tactile probe", ""};
static uint8_t port;
static bool is_open;
static uint8_t response[PROBE_INFO_BYTES], rate[4];

void probe_usb_init(probe_board *served, const char *serial_number)
{
    board = served;
    strings[3] = serial_number;
}

/* ---- descriptors ---- */

const uint8_t *tud_descriptor_device_cb(void) { return device_descriptor; }
const uint8_t *tud_descriptor_bos_cb(void) { return bos_descriptor; }

const uint8_t *tud_descriptor_configuration_cb(uint8_t index)
{
    (void)index;
    return configuration_descriptor;
}

const uint16_t *tud_descriptor_string_cb(uint8_t index, uint16_t language)
{
    static uint16_t text[1 + 30];
    uint16_t count = 0;
    (void)language;
    if (index == 0)
        text[++count] = 0x0409; /* US English */
    else if (index < 4)
        for (const char *from = strings[index]; *from != '\0' && count < 30; from++)
            text[++count] = (uint8_t)*from;
    else
        return NULL;
    text[0] = (uint16_t)(3u << 8 | (2u * count + 2u));
    return text;
}

/* ---- requests ---- */

static bool begin_request(const tusb_control_request_t *request)
{
    size_t length = 0;
    const uint8_t number = request->bRequest;
    if (request->bmRequestType == VENDOR_IN && number == MS_OS_20 && request->wIndex == MS_OS_20_INDEX)
        return tud_control_xfer(port, request, (void *)(uintptr_t)microsoft_descriptor_set, sizeof microsoft_descriptor_set);
    if (request->wIndex != 0)
        return false;
    if (request->bmRequestType == VENDOR_IN && (number == PROBE_GET_INFO || number == PROBE_GET_STATUS))
        return probe_request(board, number, request->wValue, NULL, 0, response, &length) &&
               tud_control_xfer(port, request, response, (uint16_t)length);
    if (request->bmRequestType != VENDOR_OUT)
        return false;
    if (number == PROBE_SET_RATE) /* its data come next */
        return board->stream == 0 && request->wLength == sizeof rate && tud_control_xfer(port, request, rate, sizeof rate);
    return (number == PROBE_START || number == PROBE_STOP) && request->wLength == 0 &&
           probe_request(board, number, request->wValue, NULL, 0, response, &length) && tud_control_status(port, request);
}

bool tud_vendor_control_xfer_cb(uint8_t root_port, uint8_t stage, const tusb_control_request_t *request)
{
    size_t length;
    port = root_port;
    if (stage == CONTROL_STAGE_SETUP)
        return begin_request(request);
    if (stage == CONTROL_STAGE_DATA && request->bmRequestType == VENDOR_OUT && request->bRequest == PROBE_SET_RATE)
        return probe_request(board, PROBE_SET_RATE, request->wValue, rate, sizeof rate, response, &length);
    return true;
}

/* ---- the endpoint ---- */

void probe_usb_task(void)
{
    if (!is_open || usbd_edpt_busy(port, ENDPOINT) || usbd_edpt_stalled(port, ENDPOINT))
        return;
    const uint8_t *frame = probe_next_frame(board);
    if (frame != NULL)
        (void)PROBE_USB_TRANSFER(port, ENDPOINT, (uint8_t *)(uintptr_t)frame, board->config.frame_size);
}

bool probe_usb_flush(void *context)
{
    (void)context;
    if (!is_open || !usbd_edpt_stalled(port, ENDPOINT))
        return false; /* a frame on its way leaves; the host drops it by its stream number */
    usbd_edpt_clear_stall(port, ENDPOINT);
    return true;
}

static void init(void) {}

static void reset(uint8_t root_port)
{
    port = root_port;
    is_open = false;
    probe_reset(board);
}

static uint16_t open_interface(uint8_t root_port, const tusb_desc_interface_t *interface, uint16_t length)
{
    if (interface->bInterfaceClass != 0xFF || length < INTERFACE_BYTES)
        return 0;
    reset(root_port); /* SET_CONFIGURATION ends a stream */
    const uint8_t *endpoint = (const uint8_t *)interface + 9;
    is_open = usbd_edpt_open(root_port, (const tusb_desc_endpoint_t *)(const void *)endpoint);
    return is_open ? INTERFACE_BYTES : 0;
}

/* Standard requests to the endpoint: after CLEAR_FEATURE the task sends the same frame again. */
static bool control(uint8_t root_port, uint8_t stage, const tusb_control_request_t *request)
{
    (void)root_port, (void)stage, (void)request;
    return true;
}

static bool sent(uint8_t root_port, uint8_t endpoint, xfer_result_t result, uint32_t length)
{
    (void)root_port, (void)endpoint, (void)length;
    if (result == XFER_RESULT_SUCCESS)
        probe_release_frame(board);
    probe_usb_task();
    return true;
}

const usbd_class_driver_t *usbd_app_driver_get_cb(uint8_t *count)
{
    static const usbd_class_driver_t driver = {
        .init = init, .reset = reset, .open = open_interface, .control_xfer_cb = control, .xfer_cb = sent};
    *count = 1;
    return &driver;
}
