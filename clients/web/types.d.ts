// What the server tells (docs/reference): lengths in m, angles in rad, N is north east down, B forward right down, quaternions w x y z.
export type Vec3 = [number, number, number];
export type Quat = [number, number, number, number];

export interface Shape {
  kind: "box" | "sphere" | "cylinder" | "capsule" | "plane" | "mesh";
  p?: Vec3; q?: Quat; size?: Vec3 | null; radius?: number | null; length?: number | null; mesh?: string | null;
  material?: string; colour?: Vec3; name?: string;
}
export interface Solid { name: string; shapes: Shape[]; looks?: Looks | null }
export interface Actuator {
  name: string; kind: "thruster" | "propeller" | "fin" | "ballast" | "moving_mass"; p: Vec3;
  axis?: Vec3 | null; chord?: Vec3 | null; span?: number | null; diameter?: number | null; handedness?: string;
  low?: number; high?: number; unit?: string; port?: string | null; index?: number | null;
}
export interface Beam { direction: Vec3; width?: number; near?: number; far?: number }
export interface Fan { horizontal: number; vertical: number; step: number; sector: [number, number]; bins: number; near: number; far: number }
export interface Sensor { path: string; kind: string; p: Vec3; q: Quat; beams?: Beam[]; fan?: Fan | null; address?: number; message?: string }
export interface Looks { sha256: string; size: number; p?: Vec3; q?: Quat; up?: "y" | "z"; scale?: number }
export interface Lamp { name: string; p: Vec3; q: Quat; cone: number; lumens: number }
export interface Body {
  name: string; model: string; like: string; shapes: Shape[]; mass?: number; looks?: Looks | null; actuators?: Actuator[]; sensors?: Sensor[]; lamps?: Lamp[];
  external?: boolean; ghost?: boolean; colour?: Vec3 | null;
}
export interface Beacon { name: string; sensor: string; p: Vec3; body?: string | null; delay?: number }
export type Wave = [amplitude: number, kx: number, ky: number, omega: number, phase: number, depth: number | null];
export interface Water {
  density: number; sound_speed: number; waves: Wave[]; surface_level: number; current: Vec3;
  profiles: [depth: number, velocity: Vec3][][]; jerlov: string; attenuation: Vec3; colour: Vec3;
}
export interface World {
  schema: number; revision: number; scenario: string; title: string; epoch: string; rate_hz: number;
  origin: { latitude: number; longitude: number } | null; water: Water; seabed: Solid | null; structures: Solid[];
  vehicles: Body[]; objects: Body[]; beacons: Beacon[]; meshes: Record<string, { triangles: number; low: Vec3; high: Vec3; coarse?: string | null }>;
  exact_poses: boolean; read_only: boolean;
}

export interface Frame { t: number; flags: number; revision: number; count: number; poses: Float32Array; achieved: Int8Array; arrived: number }
export interface Picture { codec: number; port: number; width: number; height: number; t: number; data: Uint8Array }

export interface Field {
  name: string; type: string; shape: number[]; unit: string; frame?: string; doc: string; minimum?: number | null; maximum?: number | null;
}
export interface Port {
  path: string; direction: "sensor" | "actuator"; kind: string; doc: string; fields: Field[]; rate_hz: number | null; timeout_s: number | null; message?: string;
  propulsors?: { name: string; r_B: Vec3; axis_B: Vec3 }[];
}
export interface Argument {
  name: string; type: string; unit: string; doc: string; required: boolean; default?: unknown; shape?: number[];
  minimum?: number | null; maximum?: number | null; choices?: string[];
}
export interface Service { path: string; doc: string; reads_only: boolean; long_running: boolean; arguments: Argument[] }
export interface Description {
  server: { name: string; version: string }; ports: Port[]; services: Service[];
  world: { scenario: string; rate_hz: number; vehicles: string[] };
}
export interface Sample { port: string; seq: number; t_ns: number; valid: boolean; value: Record<string, unknown> }
export interface Status {
  t?: number; t_ns?: number; wall?: number; real_time_factor?: number; speed?: number; lateness_p99?: number; mode?: string; paused?: boolean; held?: string[] | null;
  recording?: boolean; recorder?: { name: string; path: string; bytes: number; since_ns: number; error: string } | null; pages?: number; lease?: Record<string, { page: number; owner: string } | null>; failure?: string | null;
  playback?: { file: string; t_s: number; from_s: number; to_s: number; run: number; runs: number; loop: boolean; range_s: [number | null, number | null]; speed: number; growing: boolean } | null;
}
export interface Told { event: string; t_ns: number; text?: string; tick?: number }

declare global {
  interface Window { uw: { first?: number; frames: number; t: number; vehicles: Record<string, number[]>; errors: string[]; said: string[]; [more: string]: unknown } }
}
