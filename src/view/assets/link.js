// The socket: comes back by itself, says `ok` to every state, and knows how old things are.
//
// In: what the server sends. Out: `onhello(hello)` and `onmoment({state, images})`. The server's clock is learnt from the quickest of
// its messages, so that a slow connection makes things look older and never younger.

const RETRY_MS = 1000;
const DRIFT_MS = 0.05;

/** One energyscape as the server sends it: see src/view/screen.rs. */
export function readImage(buffer) {
  const view = new DataView(buffer);
  const number = (at) => view.getFloat32(at, true);
  return {
    sensor: view.getUint8(1), flags: view.getUint8(2), backend: view.getUint8(3),
    bearings: view.getUint16(4, true), ranges: view.getUint16(6, true),
    sequence: view.getFloat64(8, true), emittedMs: view.getFloat64(16, true),
    bearingFirst: number(24), bearingStep: number(28), rangeFirst: number(32), rangeStep: number(36),
    floorDb: number(40), stepDb: number(44),
    codes: new Uint8Array(buffer, 48),
  };
}

export class Link {
  constructor(onhello, onmoment, onchange) {
    Object.assign(this, { onhello, onmoment, onchange });
    this.open = false;
    this.offset = null;
    this.lostAt = performance.now();
    this.images = [];
    this.connect();
  }

  /** Milliseconds of the server's clock now; null before it was heard. */
  now() {
    return this.offset === null ? null : performance.now() - this.offset;
  }

  connect() {
    const address = new URL("/live", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => this.take(socket, event.data);
    socket.onclose = () => {
      if (this.open) this.lostAt = performance.now();
      this.open = false;
      this.onchange();
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  take(socket, data) {
    if (data instanceof ArrayBuffer) {
      const image = readImage(data);
      this.images[image.sensor] = image;
      return;
    }
    const message = JSON.parse(data);
    if (message.kind === "hello") {
      this.open = true;
      this.offset = null;
      this.images = [];
      this.onhello(message);
      this.onchange();
      return;
    }
    const sample = performance.now() - message.now_ms;
    this.offset = this.offset === null ? sample : Math.min(this.offset + DRIFT_MS, sample);
    socket.send("ok");
    this.onmoment({ state: message, images: this.images.slice() });
  }
}
