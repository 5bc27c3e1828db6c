// Loads what `gdibl export --to three` writes, as a LightProbeGrid of three.js (r184 and later).
//
//   import { LightProbeGridWebGL } from 'three/addons/lighting/LightProbeGridWebGL.js';
//   import { loadLightProbeGrid } from './gdibl-light-probe-grid.js';
//   scene.add( await loadLightProbeGrid( 'room.bin', LightProbeGridWebGL ) );
//
// LightProbeGridWebGL is for WebGLRenderer (called LightProbeGrid until r185), LightProbeGrid for WebGPURenderer.
import { Data3DTexture, HalfFloatType, LinearFilter, RGBAFormat, Vector3 } from 'three';

export async function loadLightProbeGrid( url, Grid ) {

	const response = await fetch( url );
	if ( ! response.ok ) throw new Error( `${ url }: ${ response.status } ${ response.statusText }` );
	return parseLightProbeGrid( await response.arrayBuffer(), Grid );

}

export function parseLightProbeGrid( buffer, Grid ) {

	const magic = String.fromCharCode( ...new Uint8Array( buffer, 0, 8 ) );
	const [ version, ...counts ] = new Uint32Array( buffer, 8, 4 );
	const [ nx, ny, nz ] = counts;
	if ( magic !== 'gdiblLPG' || version !== 1 ) throw new Error( 'not a light probe grid of gdibl, version 1' );

	const first = new Vector3().fromArray( new Float32Array( buffer, 24, 3 ) );
	const last = new Vector3().fromArray( new Float32Array( buffer, 36, 3 ) );
	const size = last.clone().sub( first );

	// Until r186 the outermost probes are on the faces of the box; from r187 half a cell inside.
	let grid = new Grid( size.x, size.y, size.z, nx, ny, nz );
	const inset = grid.getProbePosition( 0, 0, 0, new Vector3() ).x + size.x / 2;
	if ( inset > 1e-3 * size.x / nx ) grid = new Grid( ...size.toArray().map( ( s, k ) => s * counts[ k ] / ( counts[ k ] - 1 ) ), ...counts );

	grid.position.copy( first ).lerp( last, 0.5 );
	grid.updateBoundingBox();

	const texture = new Data3DTexture( new Uint16Array( buffer, 48 ), nx, ny, 7 * ( nz + 2 ) );
	texture.format = RGBAFormat;
	texture.type = HalfFloatType;
	texture.minFilter = texture.magFilter = LinearFilter;
	texture.needsUpdate = true;
	grid.texture = texture;
	return grid;

}
