/* What examples/firmware/tinyusb_board.c uses of TinyUSB, with TinyUSB's names; tests/support/hw/tinyusb_core.c defines it. */
#ifndef TUSB_H
#define TUSB_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint8_t bmRequestType, bRequest;
    uint16_t wValue, wIndex, wLength;
} tusb_control_request_t;

typedef struct {
    uint8_t bLength, bDescriptorType, bInterfaceNumber, bAlternateSetting, bNumEndpoints, bInterfaceClass;
} tusb_desc_interface_t;

typedef struct {
    uint8_t bLength, bDescriptorType, bEndpointAddress;
} tusb_desc_endpoint_t;

typedef enum { XFER_RESULT_SUCCESS, XFER_RESULT_FAILED } xfer_result_t;
enum { CONTROL_STAGE_IDLE, CONTROL_STAGE_SETUP, CONTROL_STAGE_DATA, CONTROL_STAGE_ACK };

bool tud_control_xfer(uint8_t rhport, const tusb_control_request_t *request, void *buffer, uint16_t len);
bool tud_control_status(uint8_t rhport, const tusb_control_request_t *request);

const uint8_t *tud_descriptor_device_cb(void);
const uint8_t *tud_descriptor_bos_cb(void);
const uint8_t *tud_descriptor_configuration_cb(uint8_t index);
const uint16_t *tud_descriptor_string_cb(uint8_t index, uint16_t langid);
bool tud_vendor_control_xfer_cb(uint8_t rhport, uint8_t stage, const tusb_control_request_t *request);

#endif
