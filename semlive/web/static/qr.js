// The address of the page as a QR code, for a phone; with the token, if this tab has it.

import { byId, say } from "./dom.js";

const LOCAL = ["localhost", "[::1]"];

/** Draw the code of the address with a token; an empty token gives the address for display only. */
export async function drawQr(token) {
  const { generate } = await import("./vendor/lean-qr.mjs");
  const address = `${location.origin}${location.pathname}${token ? `#token=${token}` : ""}`;
  generate(address).toCanvas(byId("qr"), { on: [0, 0, 0], off: [255, 255, 255], pad: 3 });
  const rights = token ? "It contains the token: anyone who photographs it can control the run." : "It contains no token: the phone can only view. Enter the token first to control the run from it.";
  const only = LOCAL.includes(location.hostname) || location.hostname.startsWith("127.");
  say(byId("qr-note"), `${rights}${only ? " This address works on this computer only: start the run with --page-host 0.0.0.0 and open the page by the name of this computer." : ""}`);
}
