"""Sizes and stack of the exported controller on Cortex-M, and instructions counted by QEMU.

    python studies/exported_c_cortex.py

Needs arm-none-eabi-gcc with newlib, and qemu-system-arm. The golden flight of the export runs on an
emulated Cortex-M4F in single precision. QEMU counts instructions, not cycles; the rate of an
STM32F405 is an estimate.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

import airpuck
from airpuck.control.tuning import Tuning, default_tuning

CORES = {
    "M4F": ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"),
    "M7": ("-mcpu=cortex-m7", "-mfpu=fpv5-d16"),
}
COMMON = ("-std=c99", "-O2", "-mthumb", "-mfloat-abi=hard", "-ffunction-sections")
#: Clock of an STM32F405 [Hz], and assumed cycles per instruction with wait states of the flash.
CLOCK, CYCLES = 168e6, 1.5
#: With one nanosecond per instruction, the timer of the emulated board ticks every 40.
PER_TICK = 40
LINKER = """MEMORY {
 FLASH (rx) : ORIGIN = 0x0, LENGTH = 4M
 RAM (rwx) : ORIGIN = 0x20000000, LENGTH = 4M
}
SECTIONS {
 .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) } >FLASH
 .ARM.exidx : { *(.ARM.exidx*) } >FLASH
 .data : { *(.data*) } >RAM
 .bss : { first = .; *(.bss*) *(COMMON) last = .; } >RAM
 end = .; __stack = 0x20400000;
}
"""
BOARD = """#include "airpuck.h"
#include <stdio.h>
#include <unistd.h>
#define SYSTICK ((volatile unsigned *)0xE000E010)
extern unsigned first, last;
void initialise_monitor_handles(void);
int main(int, char **);
void reset(void);
airpuck_status __real_airpuck_step(airpuck *, double, const airpuck_target *, airpuck_real *);
airpuck_status __wrap_airpuck_step(airpuck *, double, const airpuck_target *, airpuck_real *);
void __real_airpuck_pose(airpuck *, double, const airpuck_real *);
void __wrap_airpuck_pose(airpuck *, double, const airpuck_real *);
__attribute__((section(".vectors"), used)) void *const vectors[] = {(void *)0x20400000,
                                                                    (void *)reset};
static unsigned total[2], most[2], count[2], deepest;
/* Bytes of unused stack that are painted before a step, except for those of the painter. */
enum { PAINTED = 65536, OWN = 128 };
#define PAINT 0xA5A5A5A5u
static unsigned *painted(unsigned here)
{
    unsigned *low = (unsigned *)(here - PAINTED);
    for (unsigned *p = low; p < (unsigned *)(here - OWN); p++)
        *(volatile unsigned *)p = PAINT;
    return low;
}
static void noted(int kind, unsigned before)
{
    unsigned ticks = (before - SYSTICK[2]) & 0xFFFFFF;
    total[kind] += ticks;
    count[kind]++;
    most[kind] = ticks > most[kind] ? ticks : most[kind];
}
airpuck_status __wrap_airpuck_step(airpuck *craft, double now, const airpuck_target *targets,
                                   airpuck_real *command)
{
    unsigned here = (unsigned)__builtin_frame_address(0), *low = painted(here);
    unsigned before = SYSTICK[2];
    airpuck_status status = __real_airpuck_step(craft, now, targets, command);
    noted(0, before);
    while (*(volatile unsigned *)low == PAINT)
        low++;
    deepest = here - (unsigned)low > deepest ? here - (unsigned)low : deepest;
    return status;
}
void __wrap_airpuck_pose(airpuck *craft, double stamp, const airpuck_real *pose)
{
    unsigned before = SYSTICK[2];
    __real_airpuck_pose(craft, stamp, pose);
    noted(1, before);
}
void reset(void)
{
    char *words[] = {"selftest", "golden.csv", NULL};
    *(volatile unsigned *)0xE000ED88 |= 0xF << 20; /* the floating-point unit */
    for (unsigned *p = &first; p < &last; p++)
        *p = 0;
    SYSTICK[1] = 0xFFFFFF;
    SYSTICK[0] = 5;
    initialise_monitor_handles();
    int failed = main(2, words);
    for (int k = 0; k < 2; k++)
        printf("%u %u\\n", total[k] / count[k], most[k]);
    printf("%u\\n", deepest);
    fflush(stdout);
    _exit(failed);
}
"""


def tunings() -> dict[str, Tuning]:
    """Return the laws to build."""
    predictive = default_tuning().with_law("mpc")

    def shorter(**changes: object) -> Tuning:
        return predictive.with_law("mpc", **changes)

    return {
        "LQR": default_tuning(),
        "MPC, 10 steps, 6 blocks": shorter(horizon_s=0.2),
        "MPC, 10 steps, 10 blocks": shorter(horizon_s=0.2, block=(1,)),
        "MPC, 30 steps, 12 blocks": predictive,
    }


def sources(folder: Path) -> list[Path]:
    """Return the controller's sources, without the program."""
    return [p for p in sorted(folder.glob("airpuck*.c")) if p.name != "airpuck_selftest.c"]


def code(folder: Path, core: str, *options: str) -> int:
    """Return the bytes of code and constants."""
    for source in sources(folder):
        words = ["arm-none-eabi-gcc", *COMMON, *CORES[core], *options, "-c", source.name]
        subprocess.run([*words, "-o", source.with_suffix(".o").name], cwd=folder, check=True)
    words = ["arm-none-eabi-size", "-t", *[s.with_suffix(".o").name for s in sources(folder)]]
    listed = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True).stdout
    return int(listed.splitlines()[-1].split()[0])


def flight(folder: Path) -> tuple[str, list[list[int]], int]:
    """Repeat the golden flight in single precision.

    Return what the self-test prints, the instructions of steps and of poses (mean, most), and the
    most bytes of stack in a step.
    """
    (folder / "board.ld").write_text(LINKER)
    (folder / "board.c").write_text(BOARD)
    words = ["arm-none-eabi-gcc", *COMMON, *CORES["M4F"], "-DAIRPUCK_SINGLE", "-w"]
    words += [*map(str, sources(folder)), "airpuck_selftest.c", "board.c", "-T", "board.ld"]
    words += ["-Wl,--wrap=airpuck_step,--wrap=airpuck_pose", "-nostartfiles"]
    words += ["--specs=rdimon.specs", "-lm", "-o", "board.elf"]
    subprocess.run(words, cwd=folder, check=True)
    words = ["qemu-system-arm", "-M", "mps2-an386", "-kernel", "board.elf", "-nographic"]
    words += ["-icount", "shift=0", "-semihosting-config", "enable=on,target=native"]
    printed = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=600).stdout
    told, *counted, deepest = printed.splitlines()
    ticks = [[PER_TICK * int(n) for n in re.findall(r"\d+", line)] for line in counted]
    return told, ticks, int(deepest)


def main() -> None:
    model = airpuck.read_model("paper:M4")
    for name, tuning in tunings().items():
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            facts = airpuck.export.write(model, "c", folder, tuning=tuning).facts
            print(f"{name}: {', '.join(f'{key} {value}' for key, value in facts.items())}")
            for core in CORES:
                single, double = code(folder, core, "-DAIRPUCK_SINGLE"), code(folder, core)
                print(f"  {core}: {single} bytes of code in single precision, {double} in double")
            told, ((step, most), (pose, _)), stack = flight(folder)
            rate = CLOCK / CYCLES / (most + 3 * pose)
            print(f"  QEMU: {told}; {stack} bytes of stack")
            print(f"  instructions of a step: mean {step}, most {most}; of a pose: mean {pose}")
            print(f"  estimate for an STM32F405 with 3 poses per step: {rate:.0f} steps/s")


if __name__ == "__main__":
    from one_line import run

    run(main)
