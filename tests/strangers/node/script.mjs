/**
 * The npm package canopen as a master: node script.mjs PACKAGES PORT SCENARIO [ARGUMENTS]
 *
 * PACKAGES is the folder in which `npm ci` was run, PORT that of `plant-emulator serve --virtualcan`, ARGUMENTS a JSON object.
 * Each finding is a line of JSON on standard output. Exit status: 0 done, 1 not; the reason is on standard error.
 */

import { createRequire } from "node:module";
import { connect } from "node:net";
import { join } from "node:path";
import { once } from "node:events";
import { setTimeout as sleep } from "node:timers/promises";

const [packages, port, scenario, text] = process.argv.slice(2);
const { Device, DataType, Eds, LssMode } = createRequire(join(packages, "package.json"))("canopen");
const given = { node: 3, ...JSON.parse(text ?? "{}") };

const MASTER = 0x7e;
const PATIENCE_MS = 5000; // of a transfer; the package's own 30 ms are for a bus without other work on the machine
const PAYLOAD_BYTES = 14;

// -- the wire ----------------------------------------------------------------------------------------------------------

const socket = connect({ host: "127.0.0.1", port: Number(port), noDelay: true });
await once(socket, "connect");

const device = new Device({ id: MASTER, enableLss: true });
const heard = [];

function send({ id, data }) {
  const message = Buffer.alloc(4 + PAYLOAD_BYTES);
  message.writeUInt32BE(PAYLOAD_BYTES, 0);
  message.writeUInt32BE(id, 4);
  message.writeUInt8(data.length, 9);
  data.copy(message, 10);
  socket.write(message);
}

device.on("message", send);

let rest = Buffer.alloc(0);
socket.on("data", (data) => {
  rest = Buffer.concat([rest, data]);
  while (rest.length >= 4 + PAYLOAD_BYTES) {
    const id = rest.readUInt32BE(4);
    const message = { id, data: Buffer.from(rest.subarray(10, 10 + rest[9])) };
    rest = rest.subarray(4 + PAYLOAD_BYTES);
    heard.push(message);
    device.receive(message);
  }
});

// -- what the scenarios share ------------------------------------------------------------------------------------------

const say = (finding) => process.stdout.write(JSON.stringify(finding) + "\n");

async function until(what, happened) {
  const deadline = Date.now() + PATIENCE_MS;
  while (!happened()) {
    if (Date.now() > deadline) throw new Error(`not within ${PATIENCE_MS} ms: ${what}`);
    await sleep(2);
  }
}

const at = (index, subIndex, more) => ({ deviceId: given.node, index, subIndex, timeout: PATIENCE_MS, ...more });
const upload = (index, subIndex, dataType, more) => device.sdo.upload(at(index, subIndex, { dataType, ...more }));
const download = (index, subIndex, data, dataType, more) =>
  device.sdo.download(at(index, subIndex, { data, dataType, ...more }));

/** One TPDO of the node, told to carry one object on every count-th SYNC, and the master's object that takes it. */
async function listenTo(index, bits, dataType, count) {
  const cobId = 0x180 + given.node;
  await download(0x1800, 1, (0x80000000 | cobId) >>> 0, DataType.UNSIGNED32);
  await download(0x1a00, 0, 0, DataType.UNSIGNED8);
  await download(0x1a00, 1, (index << 16) | bits, DataType.UNSIGNED32);
  await download(0x1a00, 0, 1, DataType.UNSIGNED8);
  await download(0x1800, 2, count, DataType.UNSIGNED8);
  await download(0x1800, 1, cobId, DataType.UNSIGNED32);
  const object = device.eds.addEntry(0x2000, { parameterName: "Heard", dataType });
  device.eds.addReceivePdo({ cobId, dataObjects: [object] });
  return object;
}

/** Everyone operational, and a SYNC each 10 ms, with a counter where one is wanted. */
function beat(overflow) {
  device.nmt.startNode(0);
  device.eds.setSyncCobId(0x80);
  if (overflow) device.eds.setSyncOverflow(overflow);
  device.eds.setSyncGenerationEnable(true);
  device.eds.setSyncCyclePeriod(10_000);
}

// -- the scenarios -----------------------------------------------------------------------------------------------------

const scenarios = {
  async expedited() {
    say({ deviceType: await upload(0x1000, 0, DataType.UNSIGNED32) });
    say({ vendor: await upload(0x1018, 1, DataType.UNSIGNED32) });
    await download(0x1017, 0, 1234, DataType.UNSIGNED16);
    say({ heartbeat: await upload(0x1017, 0, DataType.UNSIGNED16) });
    for (const [index, subIndex] of [[0x5fff, 0], [0x1018, 9]])
      await upload(index, subIndex, DataType.UNSIGNED8).catch((error) => say({ aborted: error.code }));
    await download(0x1000, 0, 1, DataType.UNSIGNED32).catch((error) => say({ aborted: error.code }));
  },

  async segmented() {
    say({ name: await upload(0x1008, 0, DataType.VISIBLE_STRING) });
    if (given.index === undefined) return;
    await download(given.index, 0, Buffer.from(given.text));
    say({ text: (await upload(given.index, 0)).toString() });
  },

  async block() {
    const block = { blockTransfer: true, blockInterval: 0 };
    say({ name: (await upload(0x1008, 0, null, block)).toString() });
    for (const size of given.sizes) {
      const text = Buffer.from("0123456789abcdef".repeat(64).slice(0, size));
      await download(given.index, 0, text, null, block);
      const back = await upload(given.index, 0, null, block);
      say({ size, equal: text.equals(back) });
    }
    device.sdo.setBlockSize(3);
    say({ small: (await upload(given.index, 0, null, block)).length });
  },

  async nmt() {
    const states = [];
    device.nmt.on("heartbeat", ({ state }) => states.push(state));
    device.nmt.on("timeout", (deviceId) => say({ lost: deviceId }));
    device.eds.addHeartbeatConsumer(given.node, 1000);
    await download(0x1017, 0, 20, DataType.UNSIGNED16);
    for (const [command, state] of [["startNode", 5], ["stopNode", 4], ["enterPreOperational", 127], ["resetNode", 0]]) {
      device.nmt[command](given.node);
      await until(`state ${state} after ${command}`, () => states.at(-1) === state);
    }
    say({ states });
    await until("the lost heartbeat", () => device.nmt.consumers[given.node].state === null);
  },

  async pdo() {
    await download(0x6060, 0, 1, DataType.INTEGER8); // profile position
    const status = await listenTo(0x6041, 16, DataType.UNSIGNED16, 1);
    beat(0);
    await until("a status word by PDO", () => (status.value & 0x4f) === 0x40); // switch on disabled
    for (const [word, mask, wanted] of [[6, 0x6f, 0x21], [7, 0x6f, 0x23], [15, 0x6f, 0x27], [0, 0x4f, 0x40]]) {
      await download(0x6040, 0, word, DataType.UNSIGNED16);
      await until(`state after control word ${word}`, () => (status.value & mask) === wanted);
      say({ word, status: status.value & mask });
    }
  },

  async sync() {
    await download(0x1019, 0, 4, DataType.UNSIGNED8);
    await listenTo(0x6041, 16, DataType.UNSIGNED16, 2);
    const counters = [];
    device.on("message", ({ id, data }) => id === 0x80 && counters.push(data[0]));
    heard.length = 0;
    beat(4);
    await until("ten SYNCs", () => counters.length >= 10);
    device.sync.stop();
    await upload(0x1000, 0, DataType.UNSIGNED32); // what the last SYNC has caused came before its answer
    say({ counters: counters.slice(0, 10), pdos: heard.filter(({ id }) => id === 0x180 + given.node).length });
    say({ emergencies: heard.filter(({ id }) => id === 0x80 + given.node).length, syncs: counters.length });
  },

  async emergency() {
    device.emcy.on("emergency", ({ em }) => say({ code: em.code, register: em.register }));
    device.eds.addEmcyConsumer(0x80 + given.node);
    device.nmt.startNode(given.node);
    await download(0x1400, 1, 0x200 + given.node, DataType.UNSIGNED32);
    send({ id: 0x200 + given.node, data: Buffer.alloc(1) });
    await until("an emergency", () => heard.some(({ id }) => id === 0x80 + given.node));
    say({ history: (await upload(0x1003, 1, DataType.UNSIGNED32)) & 0xffff });
  },

  async time() {
    await download(0x1012, 0, 0x80000100, DataType.UNSIGNED32);
    device.eds.setTimeCobId(0x100);
    device.eds.setTimeProducerEnable(true);
    device.time.write(new Date(given.time));
    say({ time: given.time, still: await upload(0x1000, 0, DataType.UNSIGNED32) });
  },

  async eds() {
    for (const path of given.paths)
      for (const object of Eds.fromFile(path).values())
        for (const each of Object.values(object._subObjects ?? [object]))
          if (each.dataType === DataType.REAL32 || each.dataType === DataType.UNSIGNED32)
            say({ path, key: each.key, type: each.dataType, stated: each.defaultValue ?? null });
  },

  async lss() {
    let identity = null; // silence means a one: on a busy machine the package's 20 ms are no silence
    for (const timeout of [100, 400, 1600])
      identity ??= await device.lss.fastscan({ timeout, ...given.known }).catch(() => null);
    say({ identity });
    if (identity === null) throw new Error("no node was found");
    say({ serial: await device.lss.inquireSerialNumber(1000) });
    await device.lss.configureNodeId(given.to, 1000);
    await device.lss.storeConfiguration(1000);
    device.lss.switchModeGlobal(LssMode.OPERATION);
    await until("its boot-up", () => heard.some(({ id }) => id === 0x700 + given.to));
    device.eds.addSdoClientParameter(given.to, 0x600 + given.to, 0x580 + given.to);
    given.node = given.to;
    say({ deviceType: await upload(0x1000, 0, DataType.UNSIGNED32) });
  },
};

try {
  if (!(scenario in scenarios)) throw new Error(`no scenario ${scenario}; there are ${Object.keys(scenarios)}`);
  device.eds.addSdoClientParameter(given.node, 0x600 + given.node, 0x580 + given.node);
  device.start();
  await scenarios[scenario]();
} catch (error) {
  console.error(error);
  process.exitCode = 1;
} finally {
  device.stop();
  socket.destroy();
  process.exit();
}
