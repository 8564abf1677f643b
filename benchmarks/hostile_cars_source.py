"""Cars that attack what runs them, as the text of a module; `hostile_controllers.py` says what becomes of them.

It is a text, because a car's module is found by its name in a folder of its own, and is loaded by nobody else.
"""

CARS = r"""
import gc, os, signal, struct, subprocess, sys, threading, time
import numpy as np
class Honest:
    def reset(self, scenario, rng): self.front = scenario.car.front; self.rng = rng; self.scenario = scenario
    def command(self, car, a):
        gap = a.y - car.y - self.front
        return -6.0 if 0.0 <= gap <= car.speed**2/12 + 1.0 and abs(a.x - car.x) < 2.0 else 0.0
class Batch(Honest):
    def command(self, car, a): return float(self.commands(car, a))
    def commands(self, cars, a):
        gap = a.y - cars.y - self.front
        return np.where((gap >= 0) & (gap <= cars.speed**2/12 + 1.0) & (np.abs(a.x - cars.x) < 2.0), -6.0, 0.0)
# --- cheats: each would be safer if it got through
class ManyAtOnce(Batch):
    "brakes in batches of more than one"
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return np.full(np.shape(out), -8.0) if np.size(out) > 1 else out
class LaterCalls(Batch):
    "from the 200th call of commands"
    n = 0
    def commands(self, cars, a):
        if np.ndim(cars.x): LaterCalls.n += 1
        out = super().commands(cars, a)
        return np.where(np.ones(np.shape(out), bool), -8.0, out) if LaterCalls.n > 200 and np.ndim(out) else out
class EvenRows(Batch):
    "even rows of a batch"
    def commands(self, cars, a):
        out = np.array(super().commands(cars, a))
        if out.ndim and out.size > 1: out[::2] = -8.0
        return out
class LeastOfAll(Batch):
    "brakes for others in batch: minimum of all rows"
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return np.full(np.shape(out), np.min(out)) if np.ndim(out) else out
class HalfPrecision(Batch):
    "returns an int8 array whose sign wraps"
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return out.astype(np.float16) if np.ndim(out) else out
class Masked(Batch):
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return np.ma.array(out, mask=np.ones(np.shape(out), bool)) if np.ndim(out) else out
class Complex(Batch):
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return out.astype(complex) if np.ndim(out) else out
class Objects(Batch):
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return out.astype(object) if np.ndim(out) else out
class Column(Batch):
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return out[:, None] if np.ndim(out) else out
class MutatesInputs(Batch):
    "mutates what it is given"
    def commands(self, cars, a):
        out = super().commands(cars, a)
        if np.ndim(cars.x):
            a.x[:] = 100.0; cars.speed[:] = 0.0
        return out
class WritesLater(Batch):
    "frozen: keeps array and writes to it afterwards in a thread"
    def commands(self, cars, a):
        out = np.array(super().commands(cars, a))
        if out.ndim:
            threading.Timer(0.0, lambda: out.fill(-8.0)).start()
        return out
class Copied(Honest):
    def copy(self):
        made = type(self)(); made.__dict__.update(self.__dict__); made.copied = True; return made
class OtherCopy(Copied):
    "is another car as a copy"
    copied = False
    def command(self, car, a): return -8.0 if self.copied else super().command(car, a)
class SharesState(Copied):
    "copy shares state with the original"
    def reset(self, s, r): super().reset(s, r); self.shared = [0]
    def command(self, car, a):
        self.shared[0] += 1
        return min(super().command(car, a), -0.05 * self.shared[0])
class ThirdCopy(Copied):
    "copy of a copy of a copy"
    depth = 0
    def copy(self):
        made = super().copy(); made.depth = self.depth + 1; return made
    def command(self, car, a): return -8.0 if self.depth > 2 else super().command(car, a)
class CopyOfAnother(Copied):
    "copy gives another class"
    def copy(self): return Honest()
class CopyIsItself(Copied):
    def copy(self): return self
class CopyFailsLater(Copied):
    n = 0
    def copy(self):
        CopyFailsLater.n += 1
        if CopyFailsLater.n > 1000: raise ValueError("no more")
        return super().copy()
class CopySharesGenerator(Copied):
    "copy forgets its generator"
    def command(self, car, a): return super().command(car, a) - 3.0 * self.rng.random()
class CopyOfItsName(Copied):
    "same class by name"
    def copy(self):
        other = type("CopyOfItsName", (CopyOfItsName,), {"command": lambda self, car, a: -8.0})
        made = other(); made.__dict__.update(self.__dict__); return made
class CopyChangesClass(Copied):
    "sets __class__ later"
    def copy(self):
        made = super().copy(); made.__class__ = Mad; return made
class Mad(Honest):
    def command(self, car, a): return -8.0
class DeepCopyOther(Honest):
    "__deepcopy__ another car"
    def __deepcopy__(self, memo):
        m = Mad(); m.__dict__.update(self.__dict__); return m
class LooksForObjects(Honest):
    "gc referrers"
    def command(self, car, a):
        for o in gc.get_objects():
            if type(o).__name__ in ("Episode", "EpisodeLog", "Plan"): return -8.0
        return super().command(car, a)
class ReadsParent(Honest):
    "the parent's memory"
    def command(self, car, a):
        try: open(f"/proc/{os.getppid()}/maps").read(); return -8.0
        except OSError: return super().command(car, a)
class ListsParent(Honest):
    "the parent's files"
    def command(self, car, a):
        try: os.listdir(f"/proc/{os.getppid()}/fd"); return -8.0
        except OSError: return super().command(car, a)
class SeesTheScene(Honest):
    "y of the adversary leaves phi (scene)"
    def reset(self, s, r): super().reset(s, r); self.y0 = None
    def command(self, car, a):
        if self.y0 is None: self.y0 = a.y
        return -8.0 if abs(a.y - self.y0) > 0.3 else super().command(car, a)
class Clock(Honest):
    "time between questions"
    last = 0.0
    def command(self, car, a):
        now = time.perf_counter(); d = now - Clock.last; Clock.last = now
        return -8.0 if d > 0.004 else super().command(car, a)
class SaysNumber(Honest):
    "patches struct of the answers"
    def command(self, car, a):
        import skd_sim.apart.answering as w
        w.answer_with = lambda kind, value: __import__("struct").pack("<Bd", 0, -8.0)
        return super().command(car, a)
class TwoFloats(Honest):
    "float subclass that differs at each reading"
    def command(self, car, a):
        class F(float):
            n = 0
            def __float__(self): F.n += 1; return -8.0 if F.n % 2 else 0.0
        return F(super().command(car, a))
class WritesTheRoad(Honest):
    "shared memory of numpy in scenario"
    def reset(self, s, r):
        super().reset(s, r)
        try: s.road.line.setflags(write=True); s.road.line += 5
        except Exception: pass
class HasAChild(Honest):
    "a child that answers for it"
    child = None
    def command(self, car, a):
        if HasAChild.child is None: HasAChild.child = subprocess.Popen(["sleep", "1000"], start_new_session=True)
        return super().command(car, a)
class GeneratorsParity(Honest):
    "seed of its generator"
    def reset(self, s, r): super().reset(s, r); self.k = int(r.bit_generator.state["state"]["state"]) % 2
    def command(self, car, a): return -8.0 if self.k else super().command(car, a)
class CountsResets(Honest):
    "counts resets over all: kamikazes come first?"
    n = 0
    def reset(self, s, r): super().reset(s, r); CountsResets.n += 1
    def command(self, car, a): return -8.0 if CountsResets.n > 20 else super().command(car, a)
class Environment(Honest):
    "stdin/ppid environment"
    def command(self, car, a): return -8.0 if any(k.startswith("SKD") for k in os.environ) else super().command(car, a)
class ChangesPeriod(Honest):
    "control_period changes"
    n = 0
    @property
    def control_period(self):
        ChangesPeriod.n += 1; return 0.3 if ChangesPeriod.n < 5 else 0.1
class LiesOfBatches(Batch):
    "takes_batches lies"
    takes_batches = False
    def commands(self, cars, a): return np.full(np.size(cars.x), -8.0)
class TakesScene(Honest):
    takes_scene = True
    def command(self, car, scene): return super().command(car, scene.adversary)
class MinusZero(Batch):
    "commands answers -0.0 and denormals"
    def commands(self, cars, a): return super().commands(cars, a) * 5e-324 + (-0.0)
    def command(self, car, a): return 0.0
class Interrupts(Batch):
    def commands(self, cars, a):
        if np.ndim(cars.x): raise KeyboardInterrupt
        return super().commands(cars, a)
class Exits(Batch):
    def commands(self, cars, a):
        if np.ndim(cars.x): sys.exit(0)
        return super().commands(cars, a)
class Sleeps(Batch):
    n = 0
    def commands(self, cars, a):
        if np.ndim(cars.x):
            Sleeps.n += 1
            if Sleeps.n == 30: time.sleep(1000)
        return super().commands(cars, a)
class BigEndian(Batch):
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return out.astype(">f8") if np.ndim(out) else out
class ArrayOfItsOwn(Batch):
    def commands(self, cars, a):
        class A(np.ndarray):
            def astype(self, *k, **w): return np.full(self.shape, -8.0)
            def __array__(self, *k, **w): return np.full(self.shape, -8.0)
        out = super().commands(cars, a)
        return out.view(A) if np.ndim(out) else out
class ClosesFiles(Honest):
    "closes all descriptors"
    def command(self, car, a): os.closerange(3, 100); return super().command(car, a)
class WritesThePipe(Honest):
    "writes to the pipe itself"
    def command(self, car, a):
        for fd in range(3, 20):
            try: os.write(fd, b"\x00" + b"\x00"*8)
            except OSError: pass
        return super().command(car, a)
class FirstOfItsProcess(Honest):
    "another process by a shared file tells process number: worker vs alone"
    def __init__(self): self.first = not FirstOfItsProcess.__dict__.get("seen"); FirstOfItsProcess.seen = True
    def command(self, car, a): return -8.0 if self.first else super().command(car, a)
class SlowCopy(Copied):
    def copy(self): time.sleep(0.001); return super().copy()
class CopyIsNothing(Copied):
    def copy(self): return None
class CopyIsANumber(Copied):
    copy = 5
class CopyWantsMore(Copied):
    def copy(self, deep): return self
class Recurses(Honest):
    "recursion"
    def command(self, car, a): return self.command(car, a)
class Forks(Honest):
    "fork in command, the child goes on"
    n = 0
    def command(self, car, a):
        Forks.n += 1
        if Forks.n == 5 and os.fork() == 0: return -8.0
        return super().command(car, a)
class Memory(Honest):
    "memory hog"
    def command(self, car, a):
        self.x = bytearray(10**6); return super().command(car, a)
class StopsItself(Honest):
    "SIGSTOPs itself at the 100th"
    n = 0
    def command(self, car, a):
        StopsItself.n += 1
        if StopsItself.n == 100: os.kill(os.getpid(), signal.SIGSTOP)
        return super().command(car, a)
class KillsParent(Honest):
    "kills its parent"
    def command(self, car, a):
        try: os.kill(os.getppid(), signal.SIGKILL)
        except OSError: pass
        return super().command(car, a)
class LargeBatches(Batch):
    "seen rows: see-and-remember over both forms via module global"
    def command(self, car, a): return float(Batch.commands(self, car, a))
    def commands(self, cars, a):
        out = super().commands(cars, a)
        if np.ndim(out) and np.size(out) >= 100:
            gap = a.y - cars.y - self.front; t = gap / np.maximum(cars.speed, .5)
            out = np.where((t > 0) & (t < 1.5) & (np.abs(a.x + t * a.vx - cars.x) < 1.3), -8.0, out)
        return out
class SmallBatches(Batch):
    "as LargeBatches in all batches of 2 to 16, as of the search"
    def commands(self, cars, a):
        out = super().commands(cars, a)
        if np.ndim(out) and 1 < np.size(out) <= 16:
            gap = a.y - cars.y - self.front; t = gap / np.maximum(cars.speed, .5)
            out = np.where((t > 0) & (t < 1.5) & (np.abs(a.x + t * a.vx - cars.x) < 1.3), -8.0, out)
        return out
class RepeatsBatches(Batch):
    "remembers what it answered in batches"
    known = {}
    def commands(self, cars, a):
        out = super().commands(cars, a)
        if np.ndim(out) and np.size(out) > 1:
            gap = a.y - cars.y - self.front; t = gap / np.maximum(cars.speed, .5)
            out = np.where((t > 0) & (t < 1.5) & (np.abs(a.x + t * a.vx - cars.x) < 1.3), -8.0, out)
            RepeatsBatches.known.update(zip(zip(cars.y.tolist(), a.x.tolist(), a.y.tolist()), out.tolist()))
        return out
    def command(self, car, a): return RepeatsBatches.known.get((car.y, a.x, a.y), float(Batch.commands(self, car, a)))
class RepeatsCopies(Copied):
    "copy that remembers and repeats"
    known = {}
    copied = False
    def command(self, car, a):
        if self.copied:
            RepeatsCopies.known[(car.y, car.speed, a.x, a.y)] = -8.0; return -8.0
        return RepeatsCopies.known.get((car.y, car.speed, a.x, a.y), super().command(car, a))
class Threads(Honest):
    "reads /proc/self/status of seccomp; thread that answers later"
    def command(self, car, a):
        v = super().command(car, a); threading.Thread(target=lambda: os.write(2, b"")).start(); return v
class PatchesStates(Honest):
    "pickle in scenario: a class whose name collides"
    def reset(self, s, r):
        super().reset(s, r)
        import skd_sim.state as st
        st.CarState.__new__ = lambda cls, *k: tuple.__new__(cls, (0, -50, 0, 0))
class Says(Honest):
    "behind the guard"
    done = False
    def reset(self, s, r):
        super().reset(s, r)
        if not Says.done:
            import skd_sim.apart.answering as answering
            real, said = answering.answer_with, self.said
            def answer_with(kind, value):
                return real(*said) if isinstance(value, float) else real(kind, value)
            Says.done, answering.answer_with = True, answer_with
class SaysText(Says):
    said = 1, "x"
class SaysNan(Says):
    said = 0, float("nan")
class SaysInfinity(Says):
    said = 0, float("-inf")
class SaysNumbers(Says):
    said = 5, np.array([-8.0])
class MaskedByList(Batch):
    "masked"
    def commands(self, cars, a):
        out = super().commands(cars, a)
        return np.ma.array(out, mask=[True] * np.size(out)) if np.ndim(out) else out
class SeesRows(Batch):
    "In batches of the risk brakes where command has not been asked of the same crossing in the first tick."
    shown, first = set(), None
    def command(self, car, a):
        SeesRows.shown.add((car.y, a.y)); return super().command(car, a)
    def commands(self, cars, a):
        out = super().commands(cars, a)
        if not np.ndim(out) or np.size(out) < 20: return out
        if self.first is None:
            self.first = list(zip(cars.y.tolist(), a.y.tolist())); SeesRows.shown.clear(); return out
        if len(self.first) != np.size(out): return out
        return np.array([b if row in SeesRows.shown else -8.0 for row, b in zip(self.first, out)])
"""
