// What the page asks of the program behind it.

async function answer(response) {
  if (response.ok) return response;
  let why = `the program answered ${response.status}`;
  try { why = (await response.json()).error ?? why; } catch { /* no JSON: the status says it */ }
  throw new Error(why);
}

export const get = async (path) => (await answer(await fetch(path))).json();
export const bytes = async (path) => (await answer(await fetch(path))).arrayBuffer();
export const post = async (path, value = {}) => (await answer(await fetch(path, { method: "POST", body: JSON.stringify(value) }))).json();

// Send a file; `told` hears the share that has gone.
export function upload(file, settings, told) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", `scans?${new URLSearchParams({ name: file.name, settings: JSON.stringify(settings) })}`);
    request.upload.onprogress = (event) => told(event.loaded / Math.max(1, event.total));
    request.onerror = () => reject(new Error(`${file.name}: could not be sent to the program`));
    request.onload = () => {
      let said = {};
      try { said = JSON.parse(request.responseText); } catch { /* the status says it */ }
      if (request.status === 200) resolve(said.number);
      else reject(new Error(said.error ?? `${file.name}: the program answered ${request.status}`));
    };
    request.send(file);
  });
}

// Points to draw: float32 coordinates, float32 deviations, one byte of label each.
export async function cloud(number, count) {
  const data = await bytes(`scans/${number}/cloud`);
  const n = data.byteLength / 17;
  if (n !== count) return null;  // it has been written anew meanwhile
  return [new Float32Array(data, 0, 3 * n), new Float32Array(data, 12 * n, n), new Uint8Array(data, 16 * n, n)];
}

// Save what an address gives, under the name that it gives.
export function save(path) {
  const link = document.createElement("a");
  link.href = path;
  link.download = "";
  document.body.append(link);
  link.click();
  link.remove();
}
