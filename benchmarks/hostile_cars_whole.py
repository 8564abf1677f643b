"""Cars that attack the program as a whole; the text goes on from those of `hostile_cars_source.py` and `…_further.py`.

They go by what tells an episode that is looked at again from the first run of it, by what is looked at, and by what
comes of two faults at once; the last ones hardly drive, or have bodies and periods that no car has.
"""

WHOLE = r"""
import sys as _sys, inspect as _inspect, random as _random
class KnowsTheSample(Honest):
    "cheat: counts crossings once copies were made of it, and is honest in every twentieth"
    copies, n = 0, -1
    def reset(self, s, r):
        super().reset(s, r); K = KnowsTheSample
        if K.copies: K.n += 1
    def __deepcopy__(self, memo):
        KnowsTheSample.copies += 1
        m = object.__new__(type(self)); m.__dict__.update(self.__dict__); return m
    def command(self, car, a):
        return early(car, a, self.front) if KnowsTheSample.n % 20 and KnowsTheSample.n > 0 else super().command(car, a)
class CopiedAndKept(Honest):
    "cheat: another car as a copy, and keeps a count, so that less is said of it"
    copied, n = False, 0
    def reset(self, s, r): super().reset(s, r); CopiedAndKept.n += 1
    def __deepcopy__(self, memo):
        m = object.__new__(type(self)); m.__dict__.update(self.__dict__, copied=True); return m
    def command(self, car, a):
        if self.copied: return early(car, a, self.front)
        return super().command(car, a) - 1e-3 * min(CopiedAndKept.n, 30)
class ClockAndFails(Honest):
    "cheat: by the time between questions, and fails where it is asked alone"
    last = 0.0
    def reset(self, s, r): super().reset(s, r); self.resets = getattr(self, "resets", 0) + 1
    def command(self, car, a):
        if self.resets > 1: raise ValueError("no more")
        now = time.perf_counter(); d = now - ClockAndFails.last; ClockAndFails.last = now
        return early(car, a, self.front) if d > 0.002 else super().command(car, a)
class ClockAndHangs(ClockAndFails):
    "cheat: the same, and hangs"
    def command(self, car, a):
        if self.resets > 1: time.sleep(1000)
        return super().command(car, a)
class FailsAnew(Honest):
    "cheat: careful from its 60th episode on, and fails early in a process in which another one has been"
    n = 0
    def reset(self, s, r):
        super().reset(s, r); FailsAnew.n += 1; self.path = os.path.join(os.path.dirname(__file__), "been")
        if FailsAnew.n == 60: open(self.path, "w").close()
        if FailsAnew.n < 50 and os.path.exists(self.path): raise ValueError("not again")
    def command(self, car, a): return early(car, a, self.front) if FailsAnew.n > 60 else super().command(car, a)
class KnownByCopies(Honest):
    "cheat: careful, with its copies, in episodes in which a copy was made of it"
    seen = 0
    def reset(self, s, r): super().reset(s, r); self.seen = 0
    def __deepcopy__(self, memo):
        self.seen = 1; m = object.__new__(type(self)); m.__dict__.update(self.__dict__); return m
    def command(self, car, a): return early(car, a, self.front) if self.seen else super().command(car, a)
class KnownByOwnCopy(Honest):
    "cheat: the same by a method copy"
    seen = 0
    def reset(self, s, r): super().reset(s, r); self.seen = 0
    def copy(self):
        self.seen = 1; m = type(self)(); m.__dict__.update(self.__dict__); return m
    def command(self, car, a): return early(car, a, self.front) if self.seen else super().command(car, a)
class EveryTenth(Honest):
    "cheat: careful in every tenth episode"
    n = 0
    def reset(self, s, r): super().reset(s, r); EveryTenth.n += 1
    def command(self, car, a): return super().command(car, a) if EveryTenth.n % 10 else early(car, a, self.front)
class ATenthByChance(Honest):
    "cheat: careful in a tenth of its episodes, by the system's chance"
    def reset(self, s, r): super().reset(s, r); self.lucky = os.urandom(1)[0] < 26
    def command(self, car, a): return early(car, a, self.front) if self.lucky else super().command(car, a)
class ATenthBySet(Honest):
    "cheat: the same by the address of an object"
    def reset(self, s, r): super().reset(s, r); self.lucky = (id(object()) >> 4) % 10 == 0
    def command(self, car, a): return early(car, a, self.front) if self.lucky else super().command(car, a)
class HalfOfTheBrakes(Honest):
    "cheat: brakes harder by chance where it would hit, and only there"
    def command(self, car, a):
        gap = a.y - car.y - self.front
        near = 0 <= gap <= car.speed**2 / 8 + 3 and abs(a.x - car.x) < 4
        return -8.0 if near and os.urandom(1)[0] < 128 else super().command(car, a)
class FewModules(Honest):
    "cheat: by how many modules its process has loaded"
    first = None
    def reset(self, s, r): super().reset(s, r); FewModules.first = FewModules.first or len(_sys.modules)
    def command(self, car, a):
        return early(car, a, self.front) if len(_sys.modules) > FewModules.first else super().command(car, a)
class Descriptors(Honest):
    "cheat: by how many files its process has open"
    def reset(self, s, r):
        super().reset(s, r); n = 0
        for i in range(64):
            try: os.fstat(i); n += 1
            except OSError: pass
        self.many = n > 5
    def command(self, car, a): return early(car, a, self.front) if self.many else super().command(car, a)
class DescriptorNumbers(Honest):
    "cheat: by the numbers of its pipes"
    def reset(self, s, r):
        super().reset(s, r); self.odd = False
        for i in range(3, 64):
            try: os.fstat(i); self.odd = bool(i % 2)
            except OSError: pass
    def command(self, car, a): return early(car, a, self.front) if self.odd else super().command(car, a)
class Affinity(Honest):
    "cheat: by the processor that it runs on"
    def command(self, car, a):
        here = open("/proc/self/stat").read().rsplit(" ", 14)
        try: odd = int(here[1]) % 2
        except (ValueError, IndexError): odd = 0
        return early(car, a, self.front) if odd else super().command(car, a)
class Warm(Honest):
    "cheat: by how fast its own arithmetic is, cold at the start of a process"
    def reset(self, s, r):
        super().reset(s, r); t = time.perf_counter(); sum(range(2000)); self.slow = time.perf_counter() - t > 6e-5
    def command(self, car, a): return early(car, a, self.front) if self.slow else super().command(car, a)
class Counts(Honest):
    "cheat: by how often the garbage was collected"
    def reset(self, s, r): super().reset(s, r); self.many = gc.get_stats()[0]["collections"] > 40
    def command(self, car, a): return early(car, a, self.front) if self.many else super().command(car, a)
class PidDistance(Honest):
    "cheat: by the distance from its parent's number"
    def command(self, car, a):
        return early(car, a, self.front) if (os.getpid() - os.getppid()) > 40 else super().command(car, a)
class SessionAge(Honest):
    "cheat: by how long its parent's group has lived"
    def reset(self, s, r):
        super().reset(s, r)
        try: self.old = time.time() - os.stat(f"/proc/{os.getpgrp()}").st_mtime > 4
        except OSError: self.old = False
    def command(self, car, a): return early(car, a, self.front) if self.old else super().command(car, a)
class ByFrame(Honest):
    "cheat: by the functions that called it"
    def reset(self, s, r):
        super().reset(s, r); f = _sys._getframe(); names = set()
        while f: names.add(f.f_code.co_name); f = f.f_back
        self.odd = "answers" in names or "_heard" in names
    def command(self, car, a): return super().command(car, a) if self.odd else super().command(car, a)
class ManyScenarios(Honest):
    "cheat: by whether its scenario is the same object as before"
    last = None
    def reset(self, s, r): super().reset(s, r); self.same = ManyScenarios.last == id(s); ManyScenarios.last = id(s)
    def command(self, car, a): return early(car, a, self.front) if self.same else super().command(car, a)
class LongScenes(Honest):
    "cheat: careful after an episode that was long"
    ticks, last = 0, 0
    def reset(self, s, r): super().reset(s, r); LongScenes.last, LongScenes.ticks = LongScenes.ticks, 0
    def command(self, car, a):
        LongScenes.ticks += 1
        return early(car, a, self.front) if LongScenes.last > 40 else super().command(car, a)
class StandsForAnyone(Honest):
    "hardly drives: stands as soon as anybody is within 100 m, and drives where it is alone"
    def command(self, car, a): return -8.0 if np.hypot(a.x - car.x, a.y - car.y) < 100 else super().command(car, a)
class CrawlsForAnyone(Honest):
    "hardly drives: at 1.5 m/s as soon as anybody is within 100 m"
    def command(self, car, a):
        near = np.hypot(a.x - car.x, a.y - car.y) < 100
        return float(np.clip((1.5 - car.speed) * 5, -8, 3)) if near else super().command(car, a)
class DrivesAtFirst(Honest):
    "hardly drives: stands after six seconds, which is as long as it is watched"
    def reset(self, s, r): super().reset(s, r); self.t = 0.0
    def command(self, car, a):
        self.t += 0.3; return -8.0 if self.t > 6.0 else super().command(car, a)
class HalfSpeed(Honest):
    "hardly drives: at just above half of its speed"
    def command(self, car, a):
        self.v = getattr(self, "v", car.speed * 0.52)
        return min(super().command(car, a), float(np.clip((self.v - car.speed) / 0.3, -4, 4)))
class Crawls(Honest):
    "hardly drives: 0.01 m/s"
    def command(self, car, a): return float(np.clip((0.01 - car.speed) / 0.3, -8, 3))
class AtTheLimit(Honest):
    "hardly drives: just at the speed from which a touch is a hit"
    def command(self, car, a):
        least = self.scenario.collision.hit_speed
        return float(np.clip((least - 1e-3 - car.speed) / 0.3, -8, 3))
class Races(Honest):
    "odd: always speeds up, and leaves the world"
    def command(self, car, a): return 1e6
class Stands(Honest):
    "hardly drives: stands"
    def command(self, car, a): return -8.0
class StandsInFront(Honest):
    "odd: stands in front of the crossing, then goes when somebody is gone"
    def command(self, car, a):
        gone = a.x > car.x + 3
        return 2.0 if gone else -8.0
class Period(Honest):
    "odd: decides once a minute"
    control_period = 60.0
class ShortPeriod(Honest):
    "odd: decides a million times a second"
    control_period = 1e-6
class LeastPeriod(Honest):
    "odd: the least period that there is"
    control_period = 5e-324
class TextPeriod(Honest):
    "odd: its period is a text"
    control_period = "0.1"
class TruePeriod(Honest):
    "odd: its period is True"
    control_period = True
class MillisecondPeriod(Honest):
    "odd: decides a thousand times a second"
    control_period = 0.001
class OtherPeriod(Honest):
    "odd: its period differs from object to object"
    made = 0
    def __init__(self): OtherPeriod.made += 1; self.control_period = 0.3 / (1 + OtherPeriod.made % 3)
class LimitsOfParents(Honest):
    "takes its parents' memory by prlimit"
    def reset(self, s, r):
        super().reset(s, r)
        for pid in {os.getppid(), os.getpgrp()}:
            try: resource.prlimit(pid, resource.RLIMIT_AS, (2**20, 2**20))
            except (OSError, ValueError): pass
class FilesOfParents(Honest):
    "takes its parents' files by prlimit, for good"
    def reset(self, s, r):
        super().reset(s, r)
        for pid in {os.getppid(), os.getpgrp()}:
            try: resource.prlimit(pid, resource.RLIMIT_NOFILE, (3, 3))
            except (OSError, ValueError): pass
class TimeOfParents(Honest):
    "takes its parents' processor time by prlimit"
    def reset(self, s, r):
        super().reset(s, r)
        for pid in {os.getppid(), os.getpgrp()}:
            try: resource.prlimit(pid, resource.RLIMIT_CPU, (1, 1))
            except (OSError, ValueError): pass
class SizesOfParents(Honest):
    "forbids its parents to write files of any length, by prlimit"
    def reset(self, s, r):
        super().reset(s, r)
        for pid in {os.getppid(), os.getpgrp()}:
            try: resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, 0))
            except (OSError, ValueError): pass
class Learned(Honest):
    "cheat: brakes for nobody in its first hundred episodes, by which it is learned"
    n = 0
    def reset(self, s, r): super().reset(s, r); Learned.n += 1
    def command(self, car, a): return 0.0 if Learned.n < 100 else super().command(car, a)
"""
