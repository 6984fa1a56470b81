"""Print memory and instructions of the board's firmware on two Cortex-M cores, by a cross compiler and an emulator.

    python -m benchmarks.built_probe.firmware_cost

Needs ``arm-none-eabi-gcc`` (Debian: gcc-arm-none-eabi, libnewlib-arm-none-eabi) and ``pip install unicorn``. Sizes are of
``-Os``, instructions of ``-O2``, for two channels and frames of 64 bytes. The emulator counts instructions, not cycles.

Duration: seconds.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

FIRMWARE = Path(__file__).parents[2] / "examples" / "firmware"
CORES = ("cortex-m0plus", "cortex-m4")
STACK, RETURN_ADDRESS, MEMORY_BYTES = 0xFF0000, 0xF00000, 0x1000000
ROWS = 10  # of a frame
CALLS = """
#include "drive.h"
#include "probe_board.h"
static probe_board board;
static uint8_t memory[PROBE_BUFFER_BYTES(2, 64, 1000000u)];
static probe_drive wave;
volatile int16_t sink;
static void begin(void *context) { (void)context; }
void setup(void)
{
    const probe_config config = {.channels = 2, .frame_size = 64, .lowest_rate_mhz = 1000, .highest_rate_mhz = 1000000,
                                 .rate_mhz = 1000000, .scale = {1, 1}, .firmware = "", .start = begin, .stop = begin};
    uint8_t response[PROBE_INFO_BYTES];
    size_t length;
    (void)probe_init(&board, &config, memory, sizeof memory);
    (void)probe_request(&board, PROBE_START, 1, 0, 0, response, &length);
    (void)probe_drive_set(&wave, 5000, 1000000, 20000);
}
void convert(void) { const int16_t codes[2] = {1, 2}; probe_convert(&board, codes, 0); }
void fetch(void) { (void)probe_next_frame(&board); }
void release(void) { probe_release_frame(&board); }
void drive(void) { sink = probe_drive_next(&wave); }
int main(void) { return 0; }
"""


def measure_sizes(core: str, folder: Path) -> list[tuple[object, ...]]:
    """Return core, module, bytes of code with constants, and static bytes of memory."""
    rows: list[tuple[object, ...]] = []
    for source in ("probe_board", "drive"):
        compiled = folder / f"{source}.o"
        _run(
            "arm-none-eabi-gcc",
            "-std=c99",
            "-Os",
            "-mthumb",
            f"-mcpu={core}",
            "-c",
            str(FIRMWARE / f"{source}.c"),
            "-o",
            str(compiled),
        )
        text, data, bss = _run("arm-none-eabi-size", str(compiled)).splitlines()[1].split()[:3]
        rows.append((core, f"{source}.c", text, int(data) + int(bss)))
    return rows


def count_instructions(core: str, folder: Path) -> dict[str, int]:
    """Return the instructions of each call: those of ``convert`` as the mean over a frame's rows and as the maximum."""
    from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
    from unicorn.arm_const import UC_ARM_REG_LR, UC_ARM_REG_SP

    source, program, image = folder / "calls.c", folder / "calls.elf", folder / "calls.bin"
    source.write_text(CALLS, encoding="utf-8")
    sources = [str(path) for path in (source, FIRMWARE / "probe_board.c", FIRMWARE / "drive.c")]
    options = ["-std=c99", "-O2", "-mthumb", f"-mcpu={core}", f"-I{FIRMWARE}", "--specs=nosys.specs"]
    _run("arm-none-eabi-gcc", *options, *sources, "-o", str(program))
    _run("arm-none-eabi-objcopy", "-O", "binary", str(program), str(image))
    addresses = {
        name: int(address, 16) for address, _, name in map(str.split, _run("arm-none-eabi-nm", "-n", str(program)).splitlines())
    }
    load_address = int(_run("arm-none-eabi-readelf", "-lW", str(program)).split("LOAD")[1].split()[2], 16)
    machine, count = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS), [0]
    machine.mem_map(0, MEMORY_BYTES)
    machine.mem_write(load_address, image.read_bytes())
    machine.hook_add(UC_HOOK_CODE, lambda *_: count.__setitem__(0, count[0] + 1))

    def call(name: str) -> int:
        count[0] = 0
        machine.reg_write(UC_ARM_REG_SP, STACK)
        machine.reg_write(UC_ARM_REG_LR, RETURN_ADDRESS | 1)
        machine.emu_start(addresses[name] | 1, RETURN_ADDRESS)
        return count[0]

    call("setup")
    rows = [call("convert") for _ in range(ROWS)]
    frame = call("fetch") + call("release")
    return {"convert, mean": round(sum(rows) / ROWS), "convert, most": max(rows), "send a frame": frame, "drive": call("drive")}


def _run(*command: str) -> str:
    """Run a program and return what it prints."""
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def print_rows(head: tuple[str, ...], rows: list[tuple[object, ...]]) -> None:
    """Print a table as Markdown."""
    for row in (head, ("---",) * len(head), *rows):
        print(f"| {' | '.join(map(str, row))} |")


def main() -> None:
    """Print both tables."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print_rows(
            ("core", "module", "code, bytes", "static memory, bytes"),
            [row for core in CORES for row in measure_sizes(core, folder)],
        )
        counts = {core: count_instructions(core, folder) for core in CORES}
    print()
    print_rows(("instructions", *CORES), [(call, *(counts[core][call] for core in CORES)) for call in counts[CORES[0]]])


if __name__ == "__main__":
    main()
