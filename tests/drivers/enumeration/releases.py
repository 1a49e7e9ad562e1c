"""Boots of boards with pulses, with two faults and the releases of an executor, drawn from seeds.

`python -m tests.drivers.enumeration.releases --trials 2000`
"""

from __future__ import annotations

import argparse
import sys
from collections import deque
from random import Random

from hyperbit.drivers.canopen.run.heartbeat import BEAT
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wiring import Channel, Timing
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World, answering
from tests.simulation.buses.bus_model import OnItsWay

BUS, NODES = "can0", (1, 2, 5)
NAMES = ("standard", "standard", "logged-ends", "guarding-with-1029h", "all-bits")
FAULTS = (
    "executor killed",
    "executor stalled",
    "bus-off",
    "power-cycled",
    "silent",
    "lost frame",
    "lost command",
    "tool",
)
LONGEST_BOOT, AFTERWARDS = 20.0, 0.3  # [s]


class Releases(World):
    """An arm whose executor ends pulses at each tick, also while the boards boot.

    Attributes:
        broken: sentences on changes of pins that nobody has asked for.
    """

    def __init__(self, seed: int) -> None:
        self.random = random = Random(f"{seed} releases")
        self.broken: list[str] = []
        self.story: list[str] = []
        self._deaf: list[tuple[str, bool]] = []  # boards that lose their next frame, or their next NMT command
        self._frames_left, self._next = -1, ""
        self._judges = self._releases = self._switching = False
        self._syncs: deque[bool] = deque()  # SYNCs on their way, and whether each one ends a stage
        self._tool: list[Frame] = []
        self._asked: dict[str, int] | None = None  # pins of the last stage, until a boot begins
        channels = [channel for node in NODES[: random.choice((2, 3))] for channel in _channels(random, node)]
        variants = {
            f"{BUS}/{node}": answering(VARIANTS[random.choice(NAMES)], random.choice((0.0, 0.003, 0.02)))
            for node in sorted({channel.node for channel in channels})
        }
        super().__init__(channels, Timing(boot_timeout=1.0), variants=variants, shared_rpdo=random.random() < 0.8)
        lines, count = self.wiring.output_lines, len(channels)
        pulsed = [k for k, channel in enumerate(channels) if channel.pulse is not None]
        pulsed += [count + i for i, k in enumerate(self.wiring.paired) if k in pulsed]
        self._pulsed = sum(1 << k for k in pulsed)
        self._may_fall = dict.fromkeys(self._names, 0)
        for k in pulsed:
            self._may_fall[str(lines[k].board)] |= 1 << lines[k].bit
        self._pins = self._look()
        self._attached.see = self._see  # type: ignore[method-assign]

    @property
    def _names(self) -> list[str]:
        return [str(board) for board in self.wiring.boards]

    def play(self) -> None:
        """Switches the arm, and boots it with two faults; then the arm rests."""
        random = self.random
        self.up()
        self._judges = True
        self._switch(pulses=False)
        self.run(0.1)
        self._switch(pulses=True)
        self._releases = random.random() < 0.3
        self._fault(random.choice(FAULTS))
        self.run(random.choice((0.0, 0.02, 0.5)))
        self._frames_left, self._next = random.randrange(80 * len(self._names)), random.choice(FAULTS)
        self._releases, self._asked = True, None
        self.note("boot")
        self.master.boot(self.now)
        self.until(lambda: not self.master.booting, LONGEST_BOOT)
        self.run(AFTERWARDS)

    def tick(self) -> None:
        if self._releases:
            possible = self.master.outputs | self.master.doubtful
            self._switching &= self.master.committing
            if possible & self._pulsed and not self._switching:
                self.master.commit(possible & ~self._pulsed, self.now, release=True)
        super().tick()

    def send(self, bus: str, frame: Frame) -> None:
        if frame.id == cia301.SYNC:
            self._syncs.append(self._switching)
        super().send(bus, frame)

    def _switch(self, pulses: bool) -> None:
        """Switches outputs: those without pulses, or also one of the two outputs of some actuators with pulses."""
        random, count = self.random, len(self.wiring.channels)
        states = 0
        for k, channel in enumerate(self.wiring.channels):
            if channel.pulse is None:
                states |= random.getrandbits(1) << k
            elif pulses and random.random() < 0.7:
                states |= 1 << random.choice((k, count + self.wiring.paired.index(k)))
        self.note(f"to be switched: {states:b}")
        self._asked = {name: 0 for name in self._names}
        for k, line in enumerate(self.wiring.output_lines):
            self._asked[str(line.board)] |= (states >> k & 1) << line.bit
        self._switching = True
        self.master.commit(states, self.now)
        if pulses and random.random() < 0.3:
            self.run(random.uniform(0.0, 0.001))
        else:
            self.until(lambda: not self.master.committing)

    def _fault(self, kind: str) -> None:
        random, name = self.random, self.random.choice(self._names)
        self.note(f"{kind} {name}")
        if kind == "executor killed":
            for bus in self.buses.values():
                bus.drop()
            self._syncs.clear()
            self._switching = False
            self.new_master()
            self.master.boot(self.now)
        elif kind == "executor stalled":
            self.after(0.0, lambda: self.stall(random.choice((0.1, 0.6))))
        elif kind == "bus-off":
            self.buses[BUS].go_off()
            self.after(random.choice((0.02, 0.1, 0.6)), self.buses[BUS].restore)
        elif kind == "power-cycled":
            self.cycle_power(name)
        elif kind == "silent":
            lost, node = self.lost, int(name.split("/")[1])
            self.lost = lambda bus, frame: frame.id & 0x7F == node
            self.after(random.choice((0.02, 0.6)), lambda: setattr(self, "lost", lost))
        elif kind in ("lost frame", "lost command"):
            self._deaf.append((name, kind == "lost command"))
        elif kind == "tool":
            command = random.choice((Command.START, Command.STOP, Command.PRE_OPERATIONAL, Command.RESET_NODE))
            self.note(f"NMT {command:02X}h")
            self._tool.append(Frame(cia301.NMT, bytes([command, int(name.split("/")[1])])))
            self.buses[BUS].from_other(self._tool[-1])

    def _to_boards(self, bus: str, sent: OnItsWay, lost: bool) -> None:
        frame, deaf = sent.frame, list[str]()
        for name, command in list(self._deaf):
            if not _takes(name, frame) or (command and frame.id != cia301.NMT):
                continue
            self._deaf.remove((name, command))
            deaf.append(name)
            self.note(f"{name} loses {frame.id:03X}h {frame.data.hex()}")
            self.boards.silence(name)
        if frame != BEAT:
            self.note(f"{frame.id:03X}h {frame.data.hex()}")
        self._attached.receive(bus, frame, self._cause(frame))
        for name in deaf:
            self.boards.unsilence(name)
        self._frames_left -= 1
        if self._frames_left == 0:
            self.after(0.0, lambda: self._fault(self._next))

    def _cause(self, frame: Frame) -> str:
        if any(frame is each for each in self._tool):
            return "tool"
        if frame.id == cia301.SYNC and (not self._syncs or self._syncs.popleft()):
            return "stage"
        return "SDO" if frame.id & 0x780 == cia301.SDO_REQUEST else f"{frame.id:03X}h {frame.data.hex()}"

    def _see(self, cause: str, belongs_to: object = None) -> None:
        before, self._pins = self._pins, self._look()
        for name, pins in self._pins.items():
            on, off = pins & ~before[name], before[name] & ~pins
            if on or off:
                self.note(f"{name} {before[name]:b} -> {pins:b} by {cause}")
            if self._judges and cause not in ("time", "fault", "tool", "stage"):
                fallen = off & ~self._may_fall[name] and cause != "SDO"  # a boot may write outputs off
                changed = (on | fallen) & (~0 if self._asked is None else pins ^ self._asked[name])
                if changed:
                    self.broken.append(f"{cause} switches pins of {name}: {before[name]:b} -> {pins:b}")

    def _look(self) -> dict[str, int]:
        return {name: self.boards.board(name).pins for name in self._names}

    def note(self, text: str) -> None:
        self.story.append(f"{self.now - 1000:.6f} {text}")


def _channels(random: Random, node: int) -> list[Channel]:
    found = [Channel(f"{node}.pulse", BUS, node, 0, None, 1, pulse=0.05)]
    if random.random() < 0.5:
        found.append(Channel(f"{node}.second", BUS, node, 4, None, 5, pulse=0.05))
    found += [Channel(f"{node}.plain", BUS, node, 2, None)]
    return found[random.random() < 0.2 :]


def _takes(name: str, frame: Frame) -> bool:
    """Returns whether a board loses a frame of the master: commands and requests to it, RPDOs and SYNC."""
    node = int(name.split("/")[1])
    if frame.id == cia301.NMT:
        return frame.data[1] in (0, node)
    return frame.id == cia301.SYNC or 0x200 <= frame.id < 0x580 or frame.id == cia301.SDO_REQUEST + node


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, help="play only this seed, and print its story")
    options = parser.parse_args()
    seeds = range(options.trials) if options.seed is None else [options.seed]
    broken = 0
    for seed in seeds:
        trial = Releases(seed)
        trial.play()
        if options.seed is not None:
            print("\n".join(trial.story))
        for sentence in trial.broken[:1]:
            print(f"seed {seed}: {sentence}")
        broken += bool(trial.broken)
    print(f"{len(seeds)} boots, {broken} broken")
    return bool(broken)


if __name__ == "__main__":
    sys.exit(main())
