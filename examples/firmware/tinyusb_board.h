/* Binds probe_board to TinyUSB as the reader expects it: one vendor interface, one bulk endpoint 0x81, WinUSB descriptors.
 *
 * An application class driver of TinyUSB sends each frame from its place in the ring: a transfer is a packet. The vendor class
 * of TinyUSB is not used (CFG_TUD_VENDOR 0): it copies bytes through a fifo, and is mounted with two endpoints only. */
#ifndef PROBE_TINYUSB_BOARD_H
#define PROBE_TINYUSB_BOARD_H

#include "probe_board.h"

#ifndef PROBE_USB_PACKET
#define PROBE_USB_PACKET 64 /* wMaxPacketSize and size of frames: 64 at full speed, 512 at high speed */
#endif

/* Let the driver serve a board. `serial_number`: 1 to 30 ASCII characters, different for each board; it stays in use. Set `flush`
 * of its configuration to probe_usb_flush. Call it before tusb_init. */
void probe_usb_init(probe_board *board, const char *serial_number);

/* Send the next frame if the endpoint is free; call it in the main loop after tud_task. */
void probe_usb_task(void);

bool probe_usb_flush(void *context);

#endif
